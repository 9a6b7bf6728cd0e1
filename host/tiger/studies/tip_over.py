"""Does the warning come in time, and does the limiter prevent it? Randomised roll-overs (`tip_over_runs`).

Every case runs with the limiter only logging; one that tips runs once more with the limiter on. Curbs run
once. Runs are independent and go to local processes; with `keep` a run that is done is not done again.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

import tiger
from tiger.studies import tip_over_runs
from tiger.studies.report import Report, Row
from tiger.studies.tip_over_runs import KINDS, Case, Kind, Outcome, draw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from tiger.record import Record
    from tiger.rig.virtual import Rig

    Array = NDArray[np.float64]

TRIPS = 5
"""One in so many runs is a curb."""
LEAD_S = 0.5
FLAGGED_S = 0.1
SHOWN: tuple[Kind, int] = ("turn", 20010)
"""The case that the picture shows."""
EVERY_TICKS = 4
COLUMNS = ("time_s", "speed_mps", "tilt_deg", "transfer_true", "transfer", "margin", "warning", "limited")


class Pair(NamedTuple):
    """What became of one case."""

    kind: Kind
    seed: int
    logged: Outcome
    """With nothing limited."""
    limited: Outcome | None
    """With the limiter, where the first one tipped."""


class Tally(NamedTuple):
    """How many of the runs did what."""

    runs: int
    unfit: int
    """Stopped by something else than tipping, before anything was to be seen."""
    tipped: int
    warned: int
    """Of those that tipped without the limiter: warned half a second before the balance point."""
    prevented: int
    """Of the same: did not tip with the limiter."""
    impacts: int
    flagged: int
    """Impacts flagged within 100 ms, and not before."""
    late: tuple[str, ...]
    """Which runs were warned late, not prevented, or flagged late."""


def drawn(runs: int, first_seed: int = 0) -> list[tuple[Kind, int]]:
    """Kind and seed of each run; more runs begin with the same ones, and go on where fewer ended."""
    rolls = iter(range(runs))
    return [
        ("trip" if k % TRIPS == TRIPS - 1 else KINDS[next(rolls) % len(KINDS)], first_seed + k)
        for k in range(runs)
    ]


def run_both(kind: Kind, seed: int) -> Pair:
    """Run a case with the limiter only logged and, if it tipped, once more with the limiter on."""
    case = draw(kind, seed)
    logged = tip_over_runs.run(case, "log")
    again = logged.tipped and kind != "trip"
    return Pair(kind, seed, logged, tip_over_runs.run(case, "on") if again else None)


def gather(
    wanted: list[tuple[Kind, int]],
    jobs: int = -1,
    keep: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Pair]:
    """Run what `wanted` names, in `jobs` processes (-1: all cores), in order.

    Every pair is written to the file `keep` as soon as it is there, and not run again while the program is
    the same: what was interrupted goes on.
    """
    done = _kept(keep) if keep is not None else {}
    for pair in _run(wanted, done, jobs):
        if keep is not None:
            with keep.open("a", encoding="utf-8") as file:
                file.write(json.dumps(pair) + "\n")
        done[pair.kind, pair.seed] = pair
        if progress is not None:
            progress(sum(name in done for name in wanted) / len(wanted))
    return [done[name] for name in wanted]


def _run(wanted: list[tuple[Kind, int]], done: dict[tuple[Kind, int], Pair], jobs: int) -> Iterator[Pair]:
    from joblib import Parallel, delayed

    work = (delayed(run_both)(kind, seed) for kind, seed in wanted if (kind, seed) not in done)
    yield from Parallel(n_jobs=jobs, return_as="generator_unordered", pre_dispatch="2*n_jobs")(work)


def _kept(path: Path) -> dict[tuple[Kind, int], Pair]:
    """Read what an earlier run of the same program left; start the file anew otherwise."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    if not lines or lines[0] != fingerprint():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(fingerprint() + "\n", encoding="utf-8")
        return {}
    pairs = (_pair(json.loads(line)) for line in lines[1:])
    return {(pair.kind, pair.seed): pair for pair in pairs}


def _pair(kept: list[object]) -> Pair:
    kind, seed, logged, limited = kept
    outcomes = [None if one is None else _outcome(cast("list[object]", one)) for one in (logged, limited)]
    return Pair(cast("Kind", kind), cast("int", seed), cast("Outcome", outcomes[0]), outcomes[1])


def _outcome(kept: list[object]) -> Outcome:
    *head, error = kept
    return Outcome._make([*head, tuple(cast("list[float]", error))])


def fingerprint() -> str:
    """Name of this very program: a digest of all its sources and default settings."""
    digest = hashlib.sha256()
    root = Path(tiger.__file__).parent
    for path in sorted(path for kind in ("*.py", "*.toml") for path in root.rglob(kind)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def tally(pairs: list[Pair]) -> Tally:
    """Count."""
    unfit = tipped = warned = prevented = impacts = flagged = 0
    late = []
    for kind, seed, logged, limited in pairs:
        if kind == "trip":
            if math.isnan(logged.impact_s):
                unfit += 1
                continue
            impacts += 1
            after_s = logged.tripped_s - logged.impact_s
            if 0.0 <= after_s <= FLAGGED_S:
                flagged += 1
            else:
                late.append(f"{kind} {seed}: flagged after {after_s:.2f} s")
        elif limited is None:
            unfit += bool(logged.stopped)
        else:
            tipped += 1
            lead_s = logged.balance_s - logged.warned_s
            if lead_s >= LEAD_S:
                warned += 1
            else:
                late.append(f"{kind} {seed}: warned {lead_s:.2f} s ahead")
            if not limited.tipped:
                prevented += 1
            else:
                late.append(f"{kind} {seed}: not prevented")
    return Tally(len(pairs), unfit, tipped, warned, prevented, impacts, flagged, tuple(late))


def run(
    runs: int = 40,
    first_seed: int = 0,
    jobs: int = -1,
    keep: Path | None = None,
    picture: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Report:
    """Run randomised roll-overs without and with the limiter, and curbs; 1000 take 20 min on two cores."""
    pairs = gather(drawn(runs, first_seed), jobs, keep, progress)
    found = tally(pairs)
    series: dict[str, Array] = {
        "lead_s": np.array([p.logged.balance_s - p.logged.warned_s for p in pairs if p.limited is not None]),
        "flagged_ms": 1e3
        * np.array([p.logged.tripped_s - p.logged.impact_s for p in pairs if p.kind == "trip"]),
        "seed": np.array([p.seed for p in pairs]),
    }
    if picture:
        case = draw(*SHOWN)
        for name, limiter in (("unlimited", "log"), ("limited", "on")):
            series |= {f"{name}_{key}": values for key, values in _curves(case, limiter).items()}
    return Report(
        "Tipping over",
        (*_rows(found, pairs, series), *_rows_by_kind(pairs)),
        series,
        {
            "robot": "TIGER with its COM at 0.75-1.1 m, up to 30 kg on top, stronger motors, strokes held",
            "controller": "knows the load but for up to 10 % of its mass and 5 cm",
            "friction": "0.9-1.2",
            "balance point": "the COM stands over an edge, along gravity",
            "warned": f"the warning stands from {LEAD_S:g} s before the balance point until then",
            "seeds": f"{first_seed} to {first_seed + runs - 1}",
            "to be looked at": "; ".join(found.late) or "none",
        },
    )


def _rows(found: Tally, pairs: list[Pair], series: dict[str, Array]) -> tuple[Row, ...]:
    def share(part: int, whole: int) -> float:
        return 100.0 * part / whole if whole else math.nan

    leads, flagged = series["lead_s"], series["flagged_ms"][~np.isnan(series["flagged_ms"])]
    errors = np.array(
        [p.logged.transfer_error for p in pairs if p.kind != "trip" and not p.logged.stopped]
    ).reshape(-1, 2)
    return (
        Row("runs", found.runs, "-"),
        Row("unfit: stopped by something else", found.unfit, "-"),
        Row("tipped with nothing limited", found.tipped, "-"),
        Row("warned in time", share(found.warned, found.tipped), "%"),
        Row("shortest warning", float(leads.min()) if leads.size else math.nan, "s"),
        Row("median warning", float(np.median(leads)) if leads.size else math.nan, "s"),
        Row("prevented by the limiter", share(found.prevented, found.tipped), "%"),
        Row("curbs hit", found.impacts, "-"),
        Row("flagged within 100 ms", share(found.flagged, found.impacts), "%"),
        Row("latest flag", float(flagged.max()) if flagged.size else math.nan, "ms"),
        Row("lateral load transfer, RMS error, median", _median(errors[:, 0]), "-"),
        Row("longitudinal load transfer, RMS error, median", _median(errors[:, 1]), "-"),
    )


def _median(values: Array) -> float:
    return float(np.median(values)) if values.size else math.nan


def _rows_by_kind(pairs: list[Pair]) -> Iterator[Row]:
    for kind in dict.fromkeys(KINDS):
        found = tally([pair for pair in pairs if pair.kind == kind])
        if found.tipped:
            yield Row(f"{kind}: tipped of {found.runs}", found.tipped, "-")
            yield Row(f"{kind}: prevented", found.prevented, "-")


# ---- picture ------------------------------------------------


def _curves(case: Case, limiter: str) -> dict[str, Array]:
    """Series of one run."""
    rows: list[tuple[float, ...]] = []

    def watch(rig: Rig, record: Record) -> None:
        if record.tick % EVERY_TICKS:
            return
        truth, shown = rig.robot.truth(), record.outputs.estimate.stability
        lateral, _, _ = tip_over_runs.transfers(truth)
        tilt = math.degrees(
            math.acos(math.cos(math.radians(truth.roll_deg)) * math.cos(math.radians(truth.pitch_deg)))
        )
        rows.append(
            (
                *(rig.time_s, truth.speed_mps, tilt, lateral, shown.lateral_load_transfer),
                *(shown.margin, float(shown.warning), float(shown.limited)),
            )
        )

    outcome = tip_over_runs.run(case, limiter, watch)
    table = np.array(rows)
    return {name: table[:, k] for k, name in enumerate(COLUMNS)} | {
        "balance_point_s": np.array(outcome.balance_s)
    }


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw one turn with and without the limiter, and how early the warnings were."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    directory.mkdir(parents=True, exist_ok=True)
    series = {name: np.asarray(values) for name, values in report.series.items()}
    paths = []
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        if "limited_time_s" in series:
            figure = Figure(figsize=(7.0, 7.0), layout="constrained")
            _draw_turn(figure, series)
            paths.append(directory / "stability-turn.png")
            figure.savefig(paths[-1], dpi=110)
        figure = Figure(figsize=(7.0, 2.6), layout="constrained")
        early, soon = figure.subplots(1, 2)
        early.hist(series["lead_s"], bins=30)
        early.axvline(LEAD_S, color="black", lw=1.0)
        early.set_xlabel("warning before the balance point (s)")
        soon.hist(series["flagged_ms"][~np.isnan(series["flagged_ms"])], bins=20)
        soon.axvline(1e3 * FLAGGED_S, color="black", lw=1.0)
        soon.set_xlabel("flag after the impact (ms)")
        paths.append(directory / "stability-runs.png")
        figure.savefig(paths[-1], dpi=110)
    return paths


def _draw_turn(figure: object, series: dict[str, Array]) -> None:
    from matplotlib.figure import Figure

    assert isinstance(figure, Figure)
    panels = figure.subplots(4, 1, sharex=True)
    for name, color, label in (
        ("unlimited", "tab:red", "nothing limited"),
        ("limited", "tab:blue", "limiter on"),
    ):
        time_s = series[f"{name}_time_s"]
        for axes, key in zip(panels, ("margin", "transfer_true", "tilt_deg", "speed_mps"), strict=True):
            axes.plot(time_s, series[f"{name}_{key}"], color=color, lw=1.3, label=label)
        panels[1].plot(time_s, series[f"{name}_transfer"], color=color, lw=1.0, ls="--")
        foot = -0.06 if name == "unlimited" else -0.13
        warned = np.where(series[f"{name}_warning"] > 0.0, foot, np.nan)
        panels[0].plot(time_s, warned, color=color, lw=4.0, solid_capstyle="butt")
    balance_s = float(series["unlimited_balance_point_s"])
    for axes in panels:
        axes.axvline(balance_s, color="black", lw=1.0)
    beside = {"xytext": (-4, 0), "textcoords": "offset points", "ha": "right"}
    panels[3].annotate("balance point", (balance_s, 0.3), **beside)
    panels[2].legend(loc="upper left")
    for axes, text in zip(
        panels,
        (
            "margin (bars: warning)",
            "lateral load transfer\n(dashed: estimated)",
            "tilt (degrees)",
            "speed (m/s)",
        ),
        strict=True,
    ):
        axes.set_ylabel(text)
    panels[-1].set_xlabel("time (s)")
