"""The avatars that ship, from recorded evaluations of the runs that they were exported from."""

from __future__ import annotations

from charting import ROOT, Line, Row, fill_in, markdown_table, read_lines, source_line

PAGE = ROOT / "docs" / "avatars.md"
AVATARS = ROOT / "pica_core" / "pica_core" / "avatars"
REGIONS = ("mouth", "eyes", "rest")
Kind = tuple[str, int]
"""Split of the frames, and samples along each side of a pixel."""


def chart_avatars() -> None:
    """The newest evaluation of each run with one sample a pixel, with several, and on frames that
    it was trained on."""
    lines = read_lines("avatars")
    by_kind: dict[Kind, dict[str, Line]] = {}
    for line in lines:
        own = by_kind.setdefault(_kind(line), {})
        own |= {run["run"]: line for run in line["result"]["runs"]}
    if not lines:
        return
    parts = [
        part
        for kind, newest in sorted(by_kind.items())
        for part in (f"**{_title(kind)}**", _errors(newest))
    ]
    used = [line for line in lines if any(line in own.values() for own in by_kind.values())]
    sources = "\n\n".join(f"`{source_line(line)}`" for line in used)
    geometry = (
        "Mean error of depth where the true and the decoded mesh are seen, beside that of the "
        "tracked mesh that a dome would give:"
    )
    text = "\n\n".join([*parts, geometry, _geometry(by_kind["test", 1]), sources])
    fill_in(PAGE, "avatars", text)


def _errors(newest: dict[str, Line]) -> str:
    """MSE by view, with its interval, and what stands beside it."""
    views = list(dict.fromkeys(row["view"] for line in newest.values() for row in _rows(line)))
    has_floor = any(_floor(run, line) is not None for run, line in newest.items())
    header = ["avatar", *views, "mean", "PSNR dB", "SSIM", "change", "frames"]
    header += ["the head itself", "from 12 cm", "MB"] if has_floor else []
    table = []
    for run, line in newest.items():
        name, rows = _name(run), _rows(line, run)
        cells = [name]
        cells += [f"{row['mse']:.1f} ({row['mse_low']:.1f}–{row['mse_high']:.1f})" for row in rows]
        cells += [
            f"{_mean(rows, 'mse'):.1f}",
            f"{_mean(rows, 'psnr_db'):.1f}",
            f"{_mean(rows, 'ssim'):.3f}",
            f"{_mean(rows, 'temporal_mse'):.1f}",
            str(rows[0]["frames"]),
        ]
        if has_floor:
            floor, near = _floor(run, line), _run(line, run)["near"].get("mse")
            size = (AVATARS / f"{name.lower()}.pica").stat().st_size / 1e6
            cells += ["–" if value is None else f"{value:.1f}" for value in (floor, near)]
            cells.append(f"{size:.2f}")
        table.append(cells)
    return markdown_table(header, table)


def _geometry(newest: dict[str, Line]) -> str:
    """Error of true depth, of the avatar and of the mesh that a tracker would give."""
    header = ["avatar", *(f"{region}, mm" for region in REGIONS), "tracked mesh, likewise"]
    table = []
    for run, line in newest.items():
        found = _run(line, run)
        tracked = line["result"]["tracked_mesh"][found["identity"]]
        table.append(
            [
                _name(run),
                *(f"{found['geometry'][region]:.2f}" for region in REGIONS),
                " / ".join(f"{tracked[region]:.2f}" for region in REGIONS),
            ]
        )
    return markdown_table(header, table)


def _name(run: str) -> str:
    """``work/sam/run`` is of Sam."""
    return run.split("/")[-2].capitalize()


def _run(line: Line, run: str) -> Row:
    (found,) = [each for each in line["result"]["runs"] if each["run"] == run]
    return dict(found)


def _rows(line: Line, run: str = "") -> list[Row]:
    """Of one run, or of all; a person is captured once in a line."""
    rows: list[Row] = line["result"]["rows"]
    return [row for row in rows if not run or row["identity"] == _run(line, run)["identity"]]


def _floor(run: str, line: Line) -> float | None:
    """What the head itself leaves with one sample a pixel."""
    error: float | None = line["result"]["one_sample_mse"].get(_run(line, run)["identity"])
    return error


def _kind(line: Line) -> Kind:
    result = line["result"]
    return result.get("split", "test"), result["rows"][0]["samples"]


def _title(kind: Kind) -> str:
    split, side = kind
    samples = "One sample" if side == 1 else f"{side**2} samples"
    return f"{samples} a pixel{', frames that were trained on' if split == 'train' else ''}"


def _mean(rows: list[Row], field: str) -> float:
    return sum(row[field] for row in rows) / len(rows)
