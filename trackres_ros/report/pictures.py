"""The pictures of a diagnosis. Each has a text that says what it shows, for who cannot see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.diagnose import Diagnosis
from trackres_ros.diagnosis.fitting import Fit
from trackres_ros.diagnosis.locate import VARIABLES, against_travel, evenly_filled
from trackres_ros.diagnosis.regimes import Bin
from trackres_ros.diagnosis.session import Session
from trackres_ros.diagnosis.verdict import Found
from trackres_ros.plots import BLUE, GREY, ORANGE, VERMILION, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

WIDTH = 9.0
SMOOTHED_S = 20.0
LONGEST_SHOWN_S = 400.0
SHOWN_BINS = 24


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture and what it shows, in words."""

    path: Path
    title: str
    alternative: str


def draw_all(d: Diagnosis, folder: Path) -> list[Picture]:
    """Draw all pictures of a diagnosis into a folder."""
    found = [
        _before_after(d, folder / "before_after.png"),
        _regimes(d, folder / "where_regime.png"),
        _times(d, folder / "where_time.png"),
    ]
    found += [_partial(d, f, folder / f"effect_{f.name}.png") for f in d.found]
    found.append(_laps(d, folder / "held_out.png"))
    if len(d.steps[-1].separability.names) > 1:
        found.append(_matrix(d, folder / "separability.png"))
    return found


def _before_after(d: Diagnosis, path: Path) -> Picture:
    """The held-out lap on which the model gained most, over all its samples."""
    mae = d.held_out.by_lap["mae"]
    gained = mae["refitted"] - mae["with_effects"] if d.found else mae["refitted"]
    laps = [lap for lap in d.split.held_out if any((s.block[s.used] == lap).any() for s in d.sessions)]
    samples = [sum(int((s.block[s.used] == lap).sum()) for s in d.sessions) for lap in laps]
    lap = laps[int(np.argmax(gained * samples))]
    index = next(i for i, s in enumerate(d.sessions) if (s.block == lap).any())
    session = d.sessions[index]
    rows = np.flatnonzero(session.block == lap)
    rows = rows[: int(LONGEST_SHOWN_S / session.step)]
    time = session.time[rows] - session.time[rows[0]]
    measured = np.where(session.used[rows], session.torque[rows], np.nan)
    before, after = d.refitted.predicted[index].torque[rows], d.final.predicted[index].torque[rows]
    with picture(path, WIDTH, 4.6) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        upper.plot(time, measured, color=GREY, linewidth=2.5, label="measured")
        upper.plot(time, before, color=BLUE, label="simulated, base re-fitted")
        if d.found:
            upper.plot(time, after, color=VERMILION, label=f"simulated, with {', '.join(f.name for f in d.found)}")
        upper.fill_between(time, measured, before, color=ORANGE, alpha=0.35, linewidth=0, label="mismatch before")
        upper.set_ylabel("torque [Nm]")
        upper.legend(loc="upper right", ncols=2)
        upper.set_title(f"{Path(session.name).name}, a lap that was not used for fitting")
        lower.plot(time, session.speed[rows], color=GREY)
        lower.set_ylabel("speed [m/s]")
        lower.set_xlabel("time [s]")
    error = np.nanmean(np.abs(measured - before)), np.nanmean(np.abs(measured - after))
    return Picture(
        path,
        "Measured against simulated",
        f"Torque over time on a held-out lap: the mean error is {error[0]:.0f} Nm before and {error[1]:.0f} Nm after.",
    )


def _regimes(d: Diagnosis, path: Path) -> Picture:
    variables = list(dict.fromkeys(b.variable for b in d.at_base.bins))
    columns = 2
    rows = max(1, -(-len(variables) // columns))
    with picture(path, WIDTH, 1.9 * rows + 0.4) as figure:
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for axis, name in zip(axes, variables, strict=False):
            for shift, color, label, bins in (
                (-0.2, BLUE, "base re-fitted", d.at_base.bins),
                (0.2, VERMILION, "with the effects", d.at_end.bins),
            ):
                of = [b for b in bins if b.variable == name]
                if shift > 0 and not d.found:
                    continue
                axis.bar(np.arange(len(of)) + shift, [b.mean_residual for b in of], 0.38, color=color, label=label)
                for i, b in enumerate(of):
                    if b.p < 0.05:
                        axis.text(
                            i + shift,
                            b.mean_residual,
                            "*",
                            ha="center",
                            va="bottom" if b.mean_residual > 0 else "top",
                            color=color,
                        )
            of = [b for b in d.at_base.bins if b.variable == name]
            axis.set_xticks(np.arange(len(of)), [_middle(b) for b in of])
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            axis.set_title(f"{name} [{of[0].unit}]")
        for axis in axes[len(variables) :]:
            axis.set_visible(False)
        if variables:
            axes[0].legend(loc="best")
        else:
            axes[0].set_visible(True)
            axes[0].text(0.5, 0.5, "too few samples for any regime", ha="center", transform=axes[0].transAxes)
        figure.supylabel("mean residual [Nm]   (* stands out of noise)", fontsize=9)
    first = d.at_base.significant
    text = (
        "; ".join(f"{b.mean_residual:+.0f} Nm at {b.variable} {b.low:.3g} to {b.high:.3g} {b.unit}" for b in first[:5])
        or "no bin stands out of noise"
    )
    return Picture(path, "Where: by regime", f"Mean residual by bins of each variable. Before: {text}.")


def _times(d: Diagnosis, path: Path) -> Picture:
    sessions = d.sessions[:8]
    with picture(path, WIDTH, 1.25 * len(sessions) + 0.6) as figure:
        axes = figure.subplots(len(sessions), 1, squeeze=False, sharey=True).ravel()
        for i, (axis, session) in enumerate(zip(axes, sessions, strict=True)):
            for color, fit, label in ((BLUE, d.refitted, "base re-fitted"), (VERMILION, d.final, "with the effects")):
                if fit is d.final and not d.found:
                    continue
                axis.plot(session.time / 60.0, _smooth(session, fit, i), color=color, label=label, linewidth=1.0)
            held = np.isin(session.block, d.split.held_out)
            if held.any():
                axis.axvspan(
                    session.time[held][0] / 60.0,
                    session.time[held][-1] / 60.0,
                    color=GREY,
                    alpha=0.15,
                    linewidth=0,
                    label="held out",
                )
            for found in d.found[:1]:
                for span in found.where:
                    if span.recording == session.name:
                        axis.axvspan(span.begin / 60.0, span.end / 60.0, ymax=0.06, color=ORANGE, linewidth=0)
            for change in d.changes or ():
                if change.recording == session.name:
                    axis.axvline(change.time / 60.0, color=GREY, linestyle="--", linewidth=1.0, label="change of level")
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            axis.set_title(Path(session.name).name)
        axes[0].legend(*_all_labels(list(axes)), loc="upper right", ncols=3)
        axes[-1].set_xlabel("time [min]")
        figure.supylabel(f"measured less simulated torque, mean over {SMOOTHED_S:.0f} s [Nm]", fontsize=9)
    acts = f" {d.found[0].name} acts most where the bar below is orange." if d.found else ""
    return Picture(path, "Where: over time", f"Residual over the time of each recording.{acts}")


def _partial(d: Diagnosis, found: Found, path: Path) -> Picture:
    """What is left without the effect, and what the effect adds, over the variable that it follows best."""
    fit = d.final
    used = np.concatenate([s.used for s in d.sessions])
    left_over = [s.torque - p.torque for s, p in zip(d.sessions, fit.predicted, strict=True)]
    if found.acts_on != "sensor":
        left_over = against_travel(d.sessions, left_over)
    adds, residual = np.concatenate(found.resists)[used], np.concatenate(left_over)[used]
    unit, of = VARIABLES[found.acts.variable]
    label = f"{found.acts.variable} [{unit}]"
    x = np.concatenate([of(s, p.belt) for s, p in zip(d.sessions, fit.predicted, strict=True)])[used]
    _, place = evenly_filled(x, SHOWN_BINS)
    count = np.bincount(place)
    middle, term, left = (np.bincount(place, weights=w) / np.maximum(count, 1) for w in (x, adds, adds + residual))
    spread = np.sqrt(np.bincount(place, weights=(residual - (left - term)[place]) ** 2) / np.maximum(count, 1))
    with picture(path, WIDTH, 3.4) as figure:
        axis = figure.subplots()
        shown = count > 0
        axis.errorbar(
            middle[shown],
            left[shown],
            spread[shown],
            fmt="o",
            color=BLUE,
            ecolor=GREY,
            markersize=4,
            linewidth=1.0,
            label="left without the effect, mean and spread",
        )
        axis.plot(middle[shown], term[shown], color=VERMILION, label=f"{found.name} as fitted")
        axis.set_xlabel(label)
        axis.set_ylabel("torque against travel [Nm]")
        axis.legend(loc="best")
        axis.set_title(f"{found.name}: {found.text}")
    return Picture(
        path,
        f"The term: {found.name}",
        f"What is left without {found.name}, and the fitted term, over {label}; "
        f"from {term[shown].min():.0f} to {term[shown].max():.0f} Nm.",
    )


def _laps(d: Diagnosis, path: Path) -> Picture:
    h = d.held_out
    with picture(path, WIDTH, 2.6) as figure:
        axis = figure.subplots()
        stages = [("nominal", GREY, "vehicle file as it is"), ("refitted", BLUE, "base re-fitted")]
        stages += [("with_effects", VERMILION, "with the effects")] if d.found else []
        wide = 0.8 / len(stages)
        for i, (stage, color, label) in enumerate(stages):
            place = np.arange(len(h.laps)) + (i - 0.5 * (len(stages) - 1)) * wide
            axis.bar(place, h.by_lap["mae"][stage], wide, color=color, label=label)
        axis.set_xticks(np.arange(len(h.laps)), [str(i + 1) for i in range(len(h.laps))])
        axis.set_xlabel("held-out lap")
        axis.set_ylabel("mean error [Nm]")
        axis.legend(loc="best", ncols=3)
        axis.set_title("Laps that were not used for fitting")
    return Picture(
        path,
        "What it is worth",
        "Mean absolute error by held-out lap: " + ", ".join(f"{k} {v:.3g} Nm" for k, v in h.mae.items()) + " over all.",
    )


def _matrix(d: Diagnosis, path: Path) -> Picture:
    s = d.steps[-1].separability
    n = len(s.names)
    with picture(path, WIDTH, 0.28 * n + 2.0) as figure:
        axis = figure.subplots()
        image = axis.imshow(s.cosines, vmin=-1.0, vmax=1.0, cmap="PuOr_r")
        axis.set_xticks(range(n), s.names, rotation=90)
        axis.set_yticks(range(n), s.names)
        axis.grid(False)
        figure.colorbar(image, label="cosine")
        axis.set_title("How alike the effects look in these recordings, after the base was re-fitted")
    pairs = [(abs(s.cosines[i, j]), s.names[i], s.names[j]) for i in range(n) for j in range(i)]
    alike = ", ".join(f"{a} and {b}" for c, a, b in sorted(pairs, reverse=True)[:6] if c > 0.95) or "none"
    return Picture(path, "What looks alike", f"Cosines between the visible effects; alike to more than 0.95: {alike}.")


def _all_labels(axes: Sequence[Axes]) -> tuple[list[Any], list[str]]:
    """Lines and labels of all axes, each label once."""
    found = {label: line for axis in axes for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    return list(found.values()), list(found)


def _smooth(session: Session, fit: Fit, index: int) -> Array:
    residual = np.where(session.used, session.torque - fit.predicted[index].torque, 0.0)
    window = np.ones(max(1, int(SMOOTHED_S / session.step)))
    weight = np.convolve(session.used.astype(float), window, mode="same")
    mean = np.convolve(residual, window, mode="same") / np.maximum(weight, 1.0)
    return np.where(weight > 0, mean, np.nan)


def _middle(b: Bin) -> str:
    return f"{0.5 * (b.low + b.high):.3g}"
