"""`pica avatar info`, and `pica capture`: render people, rigs and yourself, and check captures."""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from pica_core.avatar.file import avatar_file, avatar_id, load_avatar
from pica_core.avatar.spec import pixel_codec_cost
from pica_core.capture.dataset.check import check_capture
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.multiface import read_json, write_aside
from pica_core.capture.person.choices import NAMED, Person, draw_person, read_person
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.subject import RigSubject, Subject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.errors import CaptureError, check_ranges
from pica_core.face_networks import FaceNetworks, load_networks
from pica_core.reference import count_parameters

if TYPE_CHECKING:
    from pica_core.capture.me.face import OwnHead


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarInfoOptions:
    """Check an avatar file as a receiver would, and show what it holds."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""


def avatar_info(options: AvatarInfoOptions) -> dict[str, Any]:
    """Show what an avatar file holds, after everything a receiver checks: who, how large, trained
    on what."""
    path = avatar_file(options.file)
    avatar = load_avatar(path)
    manifest, spec = avatar.manifest, avatar.spec
    found = {
        "name": manifest.name,
        "identity": manifest.identity,
        "sha256": avatar_id(path),
        "bytes": path.stat().st_size,
        "licence": manifest.licence,
        "block": spec.block,
        "geometry": spec.geometry,
        "levels": list(avatar.levels),
        "vertices": len(avatar.tensors["mesh.vertex_uv"]),
        "faces": len(avatar.tensors["mesh.faces"]),
        "level_faces": [len(avatar.level_faces(level)) for level in avatar.levels],
        "pixel_decoder": count_parameters(avatar.tensors, "pixel"),
        "encoding": spec.encoding,
        "decode_mmac": round(pixel_codec_cost(spec).per_object_multiply_adds / 1e6, 2),
        "model_card": dict(manifest.model_card),
    }
    for name, value in found.items():
        print(f"{name:>16}  {value}", file=sys.stderr)
    return found


SHOWN_PROBLEMS = 20
"""Problems that are shown; all are in the result."""
TEXELS_PER_PIXEL = 4
"""Side of the baked appearance against the longer side of the images: close-ups show a third of a
head, and its face covers half of the chart."""
FILE = "person.json"
"""The choices of the rendered person, in a capture."""


def _render(
    console: Console, make: Callable[[int], Subject], options: RenderOptions, out: Path
) -> dict[str, Any]:
    """Render what `make` returns for a side of its baked appearance; show how far it is."""
    side = 1 << (TEXELS_PER_PIXEL * max(options.size_px) - 1).bit_length()
    side = min(max(side, 512), 4096)
    started = time.monotonic()
    with _bar(console, "rendering", options.frames) as advance:
        counts = render_subject(lambda: make(side), options, out, advance)
    seconds = time.monotonic() - started
    console.print(f"{counts['images']} images in {out}, {seconds:.1f} s")
    return {"out": str(out), "seconds": round(seconds, 3), **counts}


@contextmanager
def _bar(console: Console, what: str, frames: int) -> Iterator[Callable[[int, int], None]]:
    """A bar of frames, on a terminal; gives what is told how many are done."""
    columns = TextColumn(what), BarColumn(), MofNCompleteColumn(), TextColumn("frames")
    shown = console.is_terminal
    with ProgressBar(*columns, TimeRemainingColumn(), console=console, disable=not shown) as bar:
        task = bar.add_task(what, total=frames)
        yield lambda done, _: bar.update(task, completed=done)


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckOptions:
    """Options of `pica capture check`."""

    capture: Path = field(kw_only=False)
    """Capture directory: one of ours, or a Multiface or Ava-256 directory as published."""


def check(options: CheckOptions) -> dict[str, Any]:
    """Find what is wrong with a capture, by reading all of it."""
    result = check_capture(options.capture)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for problem in result["problems"][:SHOWN_PROBLEMS]:
        console.print(problem, markup=False)
    if (more := len(result["problems"]) - SHOWN_PROBLEMS) > 0:
        console.print(f"... and {more} more; --json has them all")
    split = result["split"]
    console.print(
        f"{options.capture}: {'ok' if result['ok'] else 'not ok'}, {result['frames']} frames "
        f"({split['train']} for training, {split['test']} for testing), {result['cameras']} "
        f"cameras, {result['images']} images",
        markup=False,
    )
    if any(result["missing"].values()):
        told = ", ".join(f"{count} {what}" for what, count in result["missing"].items())
        console.print(f"not there: {told}")
    return result


@dataclass(frozen=True, kw_only=True, slots=True)
class ExpressionsOptions:
    """Options of `pica capture expressions`."""

    capture: Path = field(kw_only=False)
    """A Multiface or Ava-256 directory as published; gets expressions.csv and fitted.npz."""


def expressions(options: ExpressionsOptions) -> dict[str, Any]:
    """Find the 52 values of each frame of a published capture, by the face model's shapes."""
    from pica_core.capture.me.tracked import fit_capture

    capture = Capture.open(options.capture, take_fit=False)
    if not capture.is_published:
        raise CaptureError(f"{options.capture}: has its expressions")
    console = Console(stderr=True, highlight=False)
    with _bar(console, "fitting", len(capture.frames)) as advance:
        off_mm = round(1000 * fit_capture(capture, load_networks(), advance), 3)
    console.print(f"vertices are {off_mm:.2f} mm off in the mean")
    return {"frames": len(capture.frames), "off_mm": off_mm}


@dataclass(frozen=True, kw_only=True)
class LookChoices:
    """How a head looks; what is not named is as seen, or drawn from the seed."""

    hair: str | None = None
    """bald, buzz, short, swept, parted, receding, curly, afro, bob or long."""
    hair_colour: str | None = None
    """black, brown, light_brown, blond, red, grey or white."""
    eyes: str | None = None
    """brown, dark, hazel, green, blue or grey."""
    clothes: str | None = None
    """tee, vneck, shirt, turtleneck or hoodie."""
    clothes_colour: str | None = None
    """white, charcoal, navy, burgundy, olive, teal, ochre, sand or lilac."""

    def chosen(self) -> dict[str, Any]:
        """The fields of `Person` that are named.

        Raises:
            CaptureError: A name that there is not.
        """
        values = {name: getattr(self, name, None) for name in (*NAMED, "age", "skin")}
        values = {name: value for name, value in values.items() if value is not None}
        for name, value in values.items():
            if name in NAMED and value not in NAMED[name]:
                raise CaptureError(f"{name} is {value!r}; there are {', '.join(NAMED[name])}")
        return values


@dataclass(frozen=True, kw_only=True, slots=True)
class PersonOptions(LookChoices, RenderOptions):
    """Options of `pica capture person`. What is not named is drawn from the seed."""

    out: Path
    """Directory to fill; an interrupted render of the same subject and options is continued."""
    person: Path | None = None
    """A person.json: makes that person again."""
    sex: str | None = None
    """female or male."""
    age: int | None = None
    """Years, 18 to 90."""
    skin: float | None = None
    """Tone of the skin, 1 (lightest) to 6 (darkest)."""
    beard: str | None = None
    """none or stubble."""

    def choose(self) -> Person:
        """The person that is meant."""
        chosen = self.chosen()
        if self.person is None:
            return draw_person(self.seed, **chosen)
        if chosen:
            option = next(iter(chosen)).replace("_", "-")
            raise CaptureError(f"--person says all; leave out --{option}")
        return read_person(self.person)


def person(options: PersonOptions) -> dict[str, Any]:
    """Render a person of the face model into a capture directory."""
    console = Console(stderr=True, highlight=False)
    who = options.choose()
    console.print(
        f"{who.sex}, {who.age} years, skin {who.skin:g}, hair {who.hair} {who.hair_colour}, "
        f"beard {who.beard}, eyes {who.eyes}, {who.clothes} {who.clothes_colour}"
    )
    made = _render(console, lambda side: PersonSubject(who, bake_size=side), options, options.out)
    write_aside(options.out / FILE, who.as_json().encode())
    return made | {"person": str(options.out / FILE)}


@dataclass(frozen=True, kw_only=True, slots=True)
class RigOptions(RenderOptions):
    """Options of `pica capture rig`."""

    out: Path
    """Directory to fill; an interrupted render of the same subject and options is continued."""
    rig: Path
    """A .glb, .vrm or .gltf file with morph targets."""
    map: Path | None = None
    """JSON file of source names to ARKit names (or null), which goes before the rules."""


def rig(options: RigOptions) -> dict[str, Any]:
    """Render a head of your own, one with blendshapes, into a capture directory."""
    console = Console(stderr=True)
    about: dict[str, Any] = {}

    def make(side: int) -> RigSubject:
        subject = RigSubject(options.rig, options.map, bake_size=side)
        about.update(subject.about["rig"])
        _tell(console, about)
        return subject

    return _render(console, make, options, options.out) | about


def _tell(console: Console, about: dict[str, Any]) -> None:
    """Report what was understood, which explains a head that looks odd."""
    console.print(
        f"{len(about['mapped'])} shapes mapped, {len(about['missing'])} ARKit shapes missing, "
        f"{len(about['ignored'])} shapes ignored; unit {about['unit']}"
    )
    for name in ("missing", "ignored", "left_out_materials", "smaller_images", "guessed"):
        if about[name]:
            told = f"{name.replace('_', ' ')}: {', '.join(about[name])}"
            console.print(told, highlight=False)


@dataclass(frozen=True, kw_only=True)
class MeChoices(LookChoices):
    """What a real person's head is made of, and what is chosen for it."""

    scan: Path | None = None
    """A scan of the head: a .glb, .gltf, .obj or .ply file with its texture."""
    photos: Path | None = None
    """A folder of photos of the person, about twelve: JPEG, PNG, WebP or TIFF."""
    video: Path | None = None
    """A film of the person who turns the head, 2 seconds or more."""
    pupillary_distance_mm: float | None = None
    """Distance of the pupils (PD), 40 to 80, as on a prescription of glasses: sizes a head of
    photos or of a film."""
    texture: Path | None = None
    """An image to use instead of the scan's own."""
    yes: bool = False
    """The person agrees that an avatar is made of them; without it, you are asked."""


PUPILS_MM = (40.0, 80.0)
"""Distances of pupils: adults have 52 to 78 (Dodgson 2004), children from 40."""
AGREES = "Is this you, or does the person agree that an avatar is made of them? [y/N] "
MADE_OF, REPORT = "made_of.json", "report.html"
"""What a head was made of, as a folder keeps to one; and its page of pictures."""


def make_head(choices: MeChoices, folder: Path, console: Console) -> Path:
    """Fit the head that is asked for, and keep it in a folder, or take the one that is there.

    Raises:
        CaptureError: The input is of no use, the folder is another head's, or the person
            has not agreed.
        FaceNetworksError: The networks are not there.
    """
    from pica_core.capture.me.face import FILE as HEAD
    from pica_core.capture.me.nersemble import camera_films, is_nersemble
    from pica_core.capture.me.photos import photo_paths

    path = folder / HEAD
    sources = [each for each in (choices.scan, choices.photos, choices.video) if each is not None]
    if len(sources) != 1:
        raise CaptureError("name what to make the head of: one of --scan, --photos, --video")
    check_ranges(choices, CaptureError, pupillary_distance_mm=PUPILS_MM)
    if choices.scan is not None and choices.pupillary_distance_mm is not None:
        raise CaptureError("--pupillary-distance-mm belongs to --photos and --video")
    if choices.texture is not None and choices.scan is None:
        raise CaptureError(f"{choices.texture}: --texture belongs to --scan")
    if choices.photos is not None:
        paths_of = camera_films if is_nersemble(choices.photos) else photo_paths
        files = paths_of(choices.photos)
    else:
        files = [each for each in (sources[0], choices.texture) if each is not None]
    digests = [_sha256(each) for each in files]
    pupils_mm = choices.pupillary_distance_mm
    asked = {"of": digests, "chosen": choices.chosen(), "pupillary_distance_mm": pupils_mm}
    if path.exists():
        if read_json(folder / MADE_OF) != asked:
            raise CaptureError(f"{folder}: holds a head of something else; name another folder")
        return path
    networks = load_networks()
    console.print(f"Everything stays on this machine, in {folder}.", highlight=False)
    make = _of_scan if choices.scan is not None else _of_photos
    head, report = make(choices, files, networks, console)
    console.print(f"proposed, since it was not seen: {'; '.join(head.guessed)}", highlight=False)
    folder.mkdir(parents=True, exist_ok=True)
    write_aside(folder / MADE_OF, json.dumps(asked).encode())
    report(folder / REPORT)
    console.print(f"pictures of input and fitted head: {folder / REPORT}", highlight=False)
    head.write(path)
    return path


def _sha256(path: Path) -> str:
    """The SHA-256 of a file of any size."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise CaptureError(f"{path}: {error.strerror}") from error


def _agree(choices: MeChoices) -> None:
    """Ask whether the person agrees, once everything can be read."""
    if not choices.yes and not (sys.stdin.isatty() and input(AGREES).strip().lower()[:1] == "y"):
        raise CaptureError("not made: the person has to agree; --yes says that they do")


def _of_scan(
    choices: MeChoices, files: list[Path], networks: FaceNetworks, console: Console
) -> tuple["OwnHead", Callable[[Path], None]]:
    from pica_core.capture.me.register import register
    from pica_core.capture.me.report import report_scan
    from pica_core.capture.me.scan import read_scan
    from pica_core.capture.me.scanned import head_of_scan

    scan = read_scan(*files)
    _agree(choices)
    found = register(scan, networks)
    unit = found.unit or f"1/{found.face.pose.scale:.4g} m (no usual unit: sized as a face is)"
    console.print(
        f"{len(scan.faces):,} triangles, {found.up} is up, unit {unit}; "
        f"the face model lies {1000 * found.off_m:.2f} mm off in the median",
        highlight=False,
    )
    head = head_of_scan(found, choices.chosen())
    if not scan.has_colour:
        head = replace(head, guessed=("colours: the scan has none", *head.guessed))
    return head, lambda path: report_scan(path, found, head)


def _of_photos(
    choices: MeChoices, files: list[Path], networks: FaceNetworks, console: Console
) -> tuple["OwnHead", Callable[[Path], None]]:
    from pica_core.capture.me.face import NERSEMBLE_FILMS
    from pica_core.capture.me.film import choose_frames
    from pica_core.capture.me.nersemble import is_nersemble, read_films
    from pica_core.capture.me.photos import read_photos
    from pica_core.capture.me.pictured import fit_photos, head_of_photos
    from pica_core.capture.me.report import report_photos

    def tell(line: str) -> None:
        console.print(line, highlight=False, markup=False)

    if choices.photos is None:
        photos, source = choose_frames(files[0], networks, tell), "a video"
    elif is_nersemble(choices.photos):
        photos, source = read_films(files, networks, tell), NERSEMBLE_FILMS
    else:
        photos, source = read_photos(files, networks, tell), "photos"
    _agree(choices)
    pupils_mm = choices.pupillary_distance_mm
    found = fit_photos(photos, tell, pupils_mm and pupils_mm / 1000)
    head = head_of_photos(found, choices.chosen(), source)
    return head, lambda path: report_photos(path, found, head)


@dataclass(frozen=True, kw_only=True, slots=True)
class MeOptions(MeChoices, RenderOptions):
    """Options of `pica capture me`."""

    out: Path
    """Directory to fill; the fitted head is kept beside it. An interrupted render is continued."""


def me(options: MeOptions) -> dict[str, Any]:
    """Render your own head, from a scan, photos or a video, into a capture directory."""
    console = Console(stderr=True, highlight=False)
    head = make_head(options, options.out.with_name(options.out.name + "-head"), console)
    return render_me(console, head, options, options.out)


def render_me(console: Console, head: Path, options: RenderOptions, out: Path) -> dict[str, Any]:
    """Render a fitted head into a capture."""
    from pica_core.capture.me.face import OwnSubject, read_head

    return _render(console, lambda side: OwnSubject(read_head(head), bake_size=side), options, out)
