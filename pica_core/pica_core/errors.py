"""What can be wrong with an avatar, a capture or a machine.

    PicaCoreError
    ├── AvatarFileError     an avatar file that must not be used
    ├── CaptureError        a capture that cannot be read
    ├── LatentError         a latent payload that cannot be decoded, or a face that cannot be sent
    ├── ShapeError          an array of the wrong shape handed to a public function
    ├── FaceNetworksError   the networks that find faces are not there, or what runs them is not
    ├── GraphicsError       no GL context, or one that is too old
    ├── TrainingError       an option or a checkpoint of a training run that cannot be used
    ├── TrainingDivergedError   losses that are not finite or explode

``exit_code`` is what the ``pica`` command ends with when the error reaches it: 2 says that the
input or the machine is at fault and the message says how to mend it, 1 that the work failed.
"""

from dataclasses import fields


class PicaCoreError(Exception):
    """Root of the errors of this package."""

    exit_code = 2


class AvatarFileError(PicaCoreError):
    """The file is not an avatar this version can trust: names the file, the field and the limit."""


class CaptureError(PicaCoreError):
    """The capture is incomplete or inconsistent: names the file and the field."""


class LatentError(PicaCoreError, ValueError):
    """Bytes that are no latent payload, or a face that has no payload: names field and limit."""


class ShapeError(PicaCoreError, ValueError):
    """An array has the wrong shape: names the argument, its shape and the wanted one."""


class FaceNetworksError(PicaCoreError):
    """The networks that find faces, or what runs them, are not there: names what to do."""


class GraphicsError(PicaCoreError):
    """A GL context could not be made, or lacks what we need: names the fix."""


class TrainingDivergedError(PicaCoreError):
    """Losses are not finite or explode: names the step and why. The last checkpoint is good."""

    exit_code = 1


class TrainingError(PicaCoreError, ValueError):
    """An option of a training run is out of range, or a checkpoint of another run: names it."""


def check_ranges(
    owner: object, error: type[Exception] = ValueError, /, **ranges: tuple[float, float]
) -> None:
    """Refuse numbers that are out of range.

    Args:
        error: What to raise: it names the attribute, its value and the range.
        ranges: The lowest and the highest value allowed, by attribute; None only where it is the
            field's default.
    """
    unset = {field.name for field in fields(owner) if field.default is None}  # type: ignore[arg-type]
    for name, (low, high) in ranges.items():
        value = getattr(owner, name)
        if value is None and name in unset:
            continue
        if value is None or not low <= value <= high:
            told = f"{value:.12g}" if isinstance(value, float) else str(value)[:24]
            raise error(f"{name} is {told}; {low:.12g} to {high:.12g} is allowed")
