"""The avatars that ship, from recorded evaluations of the runs that they were exported from."""

from __future__ import annotations

from charting import ROOT, Line, Row, fill_in, markdown_table, read_lines, source_line

PAGE = ROOT / "docs" / "avatars.md"
AVATARS = ROOT / "pica_core" / "pica_core" / "avatars"
REGIONS = ("mouth", "eyes", "rest")


def chart_avatars() -> None:
    """The newest evaluation of each run."""
    lines = read_lines("avatars")
    newest = {run["run"]: line for line in lines for run in line["result"]["runs"]}
    if not newest:
        return
    used = [line for line in lines if line in newest.values()]
    sources = "\n\n".join(f"`{source_line(line)}`" for line in used)
    text = f"{_errors(newest)}\n\n{_geometry(newest)}\n\n{sources}"
    fill_in(PAGE, "avatars", text)


def _errors(newest: dict[str, Line]) -> str:
    """MSE by view, with its interval, and what stands beside it."""
    views = list(dict.fromkeys(row["view"] for line in newest.values() for row in _rows(line, "")))
    header = ["avatar", *views, "mean", "PSNR dB", "SSIM", "MSE of the change", "from 12 cm", "MB"]
    table = []
    for run, line in newest.items():
        name, rows = _name(run), _rows(line, run)
        near = _run(line, run)["near"].get("mse")
        table.append(
            [
                name,
                *(f"{row['mse']:.1f} ({row['mse_low']:.1f}–{row['mse_high']:.1f})" for row in rows),
                f"{_mean(rows, 'mse'):.1f}",
                f"{_mean(rows, 'psnr_db'):.1f}",
                f"{_mean(rows, 'ssim'):.3f}",
                f"{_mean(rows, 'temporal_mse'):.1f}",
                None if near is None else f"{near:.0f}",
                f"{(AVATARS / f'{name.lower()}.pica').stat().st_size / 1e6:.2f}",
            ]
        )
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


def _rows(line: Line, run: str) -> list[Row]:
    """Of one run, or of all; a person is captured once in a line."""
    rows: list[Row] = line["result"]["rows"]
    return [row for row in rows if not run or row["identity"] == _run(line, run)["identity"]]


def _mean(rows: list[Row], field: str) -> float:
    return sum(row[field] for row in rows) / len(rows)
