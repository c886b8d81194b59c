"""What campaigns found, in one table: `python -m reference.tsid.summary reference/tsid/data`.

A line is a file, or one controller of it:

    ran                  samples that it was run on: all of an `--all` file, else those that no controller before it stopped
    stopped              came to rest
    fallen               infeasible: the controller's QP was proved to have no solution; slip: a contact moved
    undecided            time: neither within the time limit; unsolved: no solver solved a QP that no proof calls infeasible
    errors               failed samples, whose rows hold the error
    seconds              median time until the stop and until the fall
    refused, again, ...  how often solvers needed help, as `CertifiedSolver` counts it, over all runs
    dips                 how often a robot was slow for less than the dwell

Of a file with a dwell (`campaign --set dwell=0.2`) it says how many labels that changed: a robot that some controller made
slow and none stopped would have counted as stopped.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from statistics import median
from typing import Any

from reference.tsid.labels import RESCUE
from reference.tsid.table import Unreadable, read

COUNTERS = ("refused", "again", "badly", "certified", "overturned", "other", "unsolved", "dips")
"""In the order in which `CertifiedSolver` uses them; and passings below the stop speed that did not last."""

REASONS = ("stopped", "infeasible", "slip", "time", "unsolved")

HEADER = (
    f"{'file':24}{'controller':22}{'ran':>7}{'stopped':>9}{'infeasible':>12}{'slip':>6}{'time':>6}{'unsolved':>10}"
    f"{'s to stop':>11}{'s to fall':>11}  " + " ".join(f"{name:>10}" for name in COUNTERS)
)


def lines(path: Path) -> list[str]:
    """The file's own line, then one a controller. Raises `Unreadable`."""
    settings, versions, rows = read(path)
    errors = [row for row in rows if "error" in row]
    size = f"{path.stat().st_size / 1e6:.2f} MB"
    about = [f"{path.name}: {len(rows)} samples, {len(errors)} errors, {size}, seed {settings['seed']}"]
    if not settings["every"]:
        for column, words in (("outcome", "best of three"), ("best_of_four", "best of four")):
            outcomes = sorted(Counter(row[column] for row in rows if column in row).items())
            about += [f"{words}: " + ", ".join(f"{number} {name}" for name, number in outcomes)] * bool(outcomes)
    about += _changed(settings, rows)
    held = [row["effort"] <= 1 for row in rows if "effort" in row]
    about.append(f"{sum(held)} of {len(held)} can be held")
    if len(versions) > 1:
        about.append(f"made by {len(versions)} sets of library versions")
    found = ["; ".join(about)]
    for controller in settings["controllers"]:
        runs = [row for row in rows if f"{controller}_outcome" in row]
        found.append(_line(path.stem, controller, runs, settings["options"].get("dt", 1.0)))
    return found + [f"{path.name}: sample {row['index']}: {row['error']}" for row in errors[:5]]


def _changed(settings: dict[str, Any], rows: list[dict[str, Any]]) -> list[str]:
    """What the dwell changed, by the best of three and of four; nothing where there is none."""
    dwell, changed = settings["options"].get("dwell", 0.0), []
    rescues = {"outcome": {RESCUE}, "best_of_four": set()}
    for column in (column for column in rescues if dwell > 0 and any(column in row for row in rows)):
        names = [name for name in settings["controllers"] if name not in rescues[column]]
        dipped = [row for row in rows if any(row.get(f"{name}_dips", 0) > 0 for name in names)]
        words = Counter(row[column] for row in dipped if row[column] != "stopped")
        told = ", ".join(f"{number} {word}" for word, number in sorted(words.items()))
        changed.append(f"{column}: {words.total()} stops changed by the dwell of {dwell:g} s" + f" ({told})" * bool(told))
    return changed


def _line(name: str, controller: str, runs: list[dict[str, Any]], dt: float) -> str:
    reasons = Counter(row[f"{controller}_reason"] for row in runs)
    counters = (sum(row.get(f"{controller}_{counter}", 0) for row in runs) for counter in COUNTERS)
    stops, falls = (
        [dt * row[f"{controller}_steps"] for row in runs if row[f"{controller}_outcome"] == outcome]
        for outcome in ("stopped", "fallen")
    )
    times = (f"{median(seconds):.2f}" if seconds else "-" for seconds in (stops, falls))
    cells = (f"{reasons[reason]:{width}}" for reason, width in zip(REASONS, (9, 12, 6, 6, 10), strict=True))
    helped = " ".join(f"{number:10}" for number in counters)
    return f"{name:24}{controller:22}{len(runs):7}{''.join(cells)}{''.join(f'{time:>11}' for time in times)}  {helped}"


def main(arguments: list[str] | None = None) -> int:
    """Print the table of files, or of a folder's. Returns the exit status: 0, or 1 if one is unreadable."""
    parser = argparse.ArgumentParser(
        prog="python -m reference.tsid.summary",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="FILE.parquet | FOLDER")
    options = parser.parse_args(arguments)
    files = [file for path in options.paths for file in (sorted(path.glob("*.parquet")) if path.is_dir() else [path])]
    if not files:
        parser.error(f"no .parquet file in {', '.join(map(str, options.paths))}")
    status, total = 0, 0
    print(HEADER)
    for path in files:
        try:
            print("\n" + "\n".join(lines(path)), flush=True)
            total += path.stat().st_size
        except (Unreadable, OSError) as error:
            print(f"summary: {error}", file=sys.stderr)
            status = 1
    print(f"\n{len(files)} files, {total / 1e6:.2f} MB")
    return status


if __name__ == "__main__":
    sys.exit(main())
