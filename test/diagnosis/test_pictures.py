# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a diagnosis as a person sees them, and what they show whatever was found."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.findings.verdict import Verdict
from trackres_ros.diagnosis.report.charts import Bars
from trackres_ros.diagnosis.report.interactive import plots_of
from trackres_ros.diagnosis.report.pictures import MOST_RECORDINGS, draw_all, first_charts, regimes, term_chart, times
from trackres_ros.diagnosis.report.series import (
    begin_minutes,
    held_out_times,
    marked_times,
    minutes,
    shown_lap,
    timeline,
)
from trackres_ros.diagnosis.report.static import draw
from trackres_ros.diagnosis.selection.locate import (
    Bin,
    Location,
    RegimeMap,
    against_travel,
    locate,
    regime_of,
    rms_over_time,
    torque_residuals,
)
from trackres_ros.effects.learned import DRIVES, SidedGain
from trackres_ros.tasks.diagnose import PICTURES
from trackres_ros.text import figures

pytest.importorskip("matplotlib")
NAMED = Verdict("named", "confirmed", "")
LONG = "2026-02-03T11-12-13_vehicle_17_test_ground_north_loop_second_driver_with_trailer_and_snow_chains_part_0001.mcap"


@pytest.fixture
def nothing_named(diagnosed):
    """The same recordings, had nothing been found."""
    return replace(diagnosed, terms=(), final=diagnosed.refitted, at_end=diagnosed.at_base)


def with_sessions(d, sessions, of):
    """What the picture over time looks at, with other sessions; `of` says of which of the old ones each is made."""
    fits = [SimpleNamespace(predicted=[fit.predicted[i] for i in of]) for fit in (d.refitted, d.final)]
    return SimpleNamespace(
        sessions=sessions, nominal=[d.nominal[i] for i in of], refitted=fits[0], final=fits[1], found=d.found, split=d.split,
        changes=d.changes, modelled=d.modelled,
    )  # fmt: skip


def lines(axes):
    """Lines over time by their label; the zero line has none."""
    return {line.get_label(): line for line in axes.get_lines() if not line.get_label().startswith("_")}


def test_every_picture_can_be_read(drawn, diagnosed, tmp_path):
    pictures = draw_all(diagnosed, tmp_path)
    names = [p.path.name for p in pictures]
    assert len(drawn.figures) == len(pictures) >= 5
    assert {file for name in PICTURES for file in tmp_path.glob(name)} == {p.path for p in pictures}  # as a later one removes
    assert names[0] == "believed.svg"
    assert names.index("where_time.svg") < names.index("where_regime.svg")
    for picture, figure in zip(pictures, drawn.figures, strict=True):
        assert not drawn.faults(figure), picture.path.name
        assert "-0 " not in picture.alternative
        assert "e+" not in picture.alternative


def test_both_back_ends_draw_the_same_series(drawn, diagnosed, tmp_path):
    for chart in first_charts(diagnosed).values():
        draw(chart, tmp_path / "c.png")
        axes = [axis for axis in drawn.figures[-1].axes if axis.get_visible()]
        labels = {label for axis in axes for label in axis.get_legend_handles_labels()[1]}
        assert labels == {text for _, text, _ in chart.legend()}
        plots = [plot.attributes for plot in plots_of(chart)]
        titles = [plot["title"].attributes["text"] for plot in plots]
        assert sorted(titles) == sorted(axis.get_title(loc="left") for axis in axes)
        for panel, plot in zip(chart.panels, plots, strict=True):
            renderers = [(item.attributes["glyph"].name, item.attributes["data_source"]) for item in plot["renderers"]]
            columns_of = [(glyph, source.attributes["data"]) for glyph, source in renderers]
            for number, line in enumerate(panel.lines):
                shown_text = next(columns[f"y{number}"] for glyph, columns in columns_of if glyph == "Line")
                wanted = np.concatenate([[*y, np.nan] for _, y in line.pieces])
                np.testing.assert_allclose(shown_text, wanted, atol=0.01 * max(1.0, np.nanmax(np.abs(wanted))))
            tops = [columns["top"] for glyph, columns in columns_of if glyph == "VBar"]
            for bars, shown_text in zip([item for item in panel.elements if isinstance(item, Bars)], tops, strict=True):
                np.testing.assert_allclose(shown_text, bars.height, atol=0.1)


@pytest.mark.parametrize("named", [True, False])
def test_the_residual_over_time_is_drawn_with_or_without_names(drawn, diagnosed, nothing_named, tmp_path, named):
    d = diagnosed if named else nothing_named
    draw(times(d), tmp_path / "t.png")
    axes = drawn.figures[0].axes
    assert len(axes) == len(d.sessions)
    for axis, session in zip(axes, d.sessions, strict=True):
        shown = lines(axis)
        assert {"model as given", "base re-fitted"} <= set(shown)
        assert ("with the effects" in shown) == named
        assert shown["model as given"].get_linewidth() < shown["base re-fitted"].get_linewidth()
        for line in shown.values():
            assert np.isfinite(line.get_ydata()).mean() > 0.8 * session.used.mean()


@pytest.mark.parametrize("named", [True, False])
def test_the_first_picture_has_the_residual_and_its_terms(drawn, diagnosed, nothing_named, tmp_path, named):
    d = diagnosed if named else nothing_named
    picture = draw(timeline(d), tmp_path / "b.png")
    assert not drawn.faults(drawn.figures[0])
    axes = drawn.figures[0].axes
    assert len(axes) == 1 + named
    upper = lines(axes[0])
    assert set(upper) == {
        "measured minus re-fitted model",
        "turning scrub" if named else f"measured minus model as given ({figures(d.held_out.mae['nominal'])} Nm)",
    }
    for stage in ("refitted", "with_effects")[: 1 + named]:
        assert f"{figures(d.held_out.mae[stage])} Nm" in axes[stage == "with_effects"].get_title(loc="left")
    ends = begin_minutes(d)
    assert ends[-1] == pytest.approx(sum(len(s) * s.step for s in d.sessions) / 60.0, rel=1e-3)
    seconds = sum(int(s.used[np.isin(s.block, d.split.held_out)].sum()) * s.step for s in d.sessions)
    assert seconds <= 60.0 * sum(end - begin for begin, end in held_out_times(d)) < 60.0 * ends[-1]
    assert marked_times(replace(d, verdict=NAMED))[0] == (d.found[0].location.text if named else "")
    assert "re-fitted model" in picture.alternative


def test_the_terms_and_what_is_left_add_up_to_the_residual(drawn, diagnosed, tmp_path):
    """Several terms: each less what a re-fit takes up of it; the wrong one is dashed."""
    (item,) = diagnosed.found
    other = replace(
        item,
        effect=SimpleNamespace(name="another_with_a_long_name_that_takes_its_room"),
        adds=[np.where(s.used, 5.0 * np.sin(s.time / 40.0), 0.0) for s in diagnosed.sessions],
    )
    unsure = replace(other, improvement=replace(item.improvement, low=-9.0, likelihood_bound=-1.0))
    for d in (diagnosed, replace(diagnosed, terms=(item, unsure))):
        draw(timeline(d), tmp_path / "b.png")
        assert not drawn.faults(drawn.figures[-1])
        above, below = timeline(d).panels
        *terms, residual = above.lines
        (remainder,) = below.lines
        assert [t.is_dashed for t in terms] == [False, True][: len(terms)]
        assert len({line.colour for panel in (above, below) for line in panel.lines}) == len(terms) + 2
        for i in range(len(d.sessions)):
            of_terms, (_, rest), (_, total) = (t.pieces[i][1] for t in terms), remainder.pieces[i], residual.pieces[i]
            np.testing.assert_allclose(sum(of_terms) + rest, total, atol=1e-6)
    scrub = item.adds
    share = [np.nanstd(t.pieces[0][1]) / np.std(scrub[0]) for t in terms]
    assert share[0] > 0.3 > share[1]


def test_a_gap_breaks_the_line(drawn, diagnosed, tmp_path):
    used = diagnosed.sessions[0].used.copy()
    begin, end = 200, 260
    used[begin:end] = False
    holed = replace(diagnosed.sessions[0], used=used)
    draw(times(with_sessions(diagnosed, [holed], [0])), tmp_path / "t.png")
    minutes = holed.time[[begin + 5, end - 5]] / 60.0
    for line in lines(drawn.figures[0].axes[0]).values():
        x, y = line.get_xdata(), line.get_ydata()
        assert np.isnan(y[(x > minutes[0]) & (x < minutes[1])]).all()


@pytest.mark.parametrize("longest_s", [20.0, 50.0, 1e4])
def test_of_a_long_lap_the_part_with_the_most_mismatch_is_drawn(diagnosed, longest_s):
    """Much of each lap is parked; the errors are those of the whole lap all the same."""
    d = diagnosed
    sessions = [replace(s, used=s.used & (s.time % 60.0 > 30.0), torque=np.where(s.used, s.torque, np.nan)) for s in d.sessions]
    parked = SimpleNamespace(sessions=sessions, refitted=d.refitted, held_out=d.held_out, split=d.split, modelled=d.modelled)
    index, rows, text, *errors = shown_lap(parked, longest_s)
    session, number = sessions[index], d.split.held_out.index(int(sessions[index].block[rows[0]]))
    assert errors == [d.held_out.by_lap["mae"][stage][number] for stage in ("refitted", "with_effects")]
    lap = np.flatnonzero(session.block == session.block[rows[0]])
    assert text == ("a hold-out lap" if len(rows) == len(lap) else f"the worst {len(rows)} s of a hold-out lap")
    assert len(rows) == min(len(lap), longest_s)
    deviation = np.where(session.used, np.abs(session.torque - d.refitted.predicted[index].torque), 0.0)
    others = [deviation[lap[i : i + len(rows)]].sum() for i in range(len(lap) - len(rows) + 1)]
    assert deviation[rows].sum() == pytest.approx(max(others))


@pytest.mark.parametrize("cuts", [[1], [400], [100, 700, 950]])
def test_the_error_over_time_does_not_depend_on_cuts(cuts):
    residual = np.random.default_rng(1).normal(0.0, np.linspace(1.0, 50.0, 1000))
    residual[200:300] = np.nan
    assert rms_over_time(np.split(residual, cuts))[1] == pytest.approx(rms_over_time([residual])[1])


def test_the_regime_of_an_effect_has_the_mean_over_marked_times(diagnosed):
    """Also where its variable is simulated, and the last fit has other belt temperatures."""
    d = diagnosed
    warmer = replace(d.final, predicted=[replace(p, belt=p.belt + 7.0) for p in d.final.predicted])
    belts = np.concatenate([p.belt for p in warmer.predicted])
    location = Location("belt temperature", "degC", float(np.median(belts)), belts.max(), belts.min(), belts.max(), 0.0, 1.0, 1.0)
    (here, *_) = regime_of(d.refitted, warmer, d.at_base, location)
    d = replace(d, final=warmer, terms=(replace(d.found[0], location=location),), verdict=NAMED)
    text, marked = marked_times(d)
    assert text == location.text
    middle = np.concatenate([minutes(d, i) + s.step / 120.0 for i, s in enumerate(d.sessions)])
    inside = np.any([(begin < middle) & (middle < end) for begin, end in marked], axis=0)
    residual = np.concatenate(against_travel(d.sessions, torque_residuals(d.refitted)))
    assert here.samples == inside.sum()
    assert here.mean_residual == pytest.approx(residual[inside].mean())


def test_the_size_of_an_effect_is_its_mean_where_it_acts(diagnosed):
    """Not the mean residual of a base that absorbed a part of it."""
    sessions = diagnosed.sessions
    location = locate(diagnosed.final, [100.0 * (s.speed > 2.0) for s in sessions])
    speed = np.concatenate([s.speed[s.used] for s in sessions])
    is_inside = (speed >= location.low) & (speed <= location.high)
    assert location.variable == "speed"
    assert location.mean == pytest.approx(100.0 * np.mean(speed[is_inside] > 2.0))
    assert location.rms == pytest.approx(100.0 * np.sqrt(np.mean(speed > 2.0)))


def test_a_sided_gain_is_drawn_of_steps_where_it_acts(drawn, diagnosed, tmp_path):
    adds = [np.where(s.time % 40.0 < 10.0, 100.0 * np.sign(s.speed), 0.0) for s in diagnosed.sessions]
    term = Term(SidedGain(DRIVES, 1000.0), None, adds=adds, sentences=("It needs 100 Nm more",), gate="while it drives")
    picture = draw(term_chart(diagnosed, term), tmp_path / "t.png")
    y = lines(drawn.figures[0].axes[0])[f"{term.name} as fitted"].get_ydata()
    np.testing.assert_allclose(y, 100.0)
    assert "from 100 to 100 Nm" in picture.alternative


@pytest.mark.parametrize("count", [1, 9, 70])
def test_any_number_of_recordings_with_any_names(drawn, diagnosed, tmp_path, count):
    item = [i % 2 for i in range(count)]
    sessions = [replace(diagnosed.sessions[i], name=f"{k}/{LONG}") for k, i in enumerate(item)]
    picture = draw(times(with_sessions(diagnosed, sessions, item)), tmp_path / "t.png")
    (figure,) = drawn.figures
    assert not drawn.faults(figure)
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert len(set(titles)) == len(titles) == min(count, MOST_RECORDINGS)
    if count > MOST_RECORDINGS:
        assert f"error are drawn; {count - MOST_RECORDINGS} are not drawn" in picture.alternative
    else:
        assert "not drawn" not in picture.alternative


@pytest.mark.parametrize(
    "edges",
    [
        [0.0217, 0.0221, 0.0229, 0.0241, 0.0251, 0.0262, 0.0277],
        [-0.2123, -0.1119, -0.0217, -0.0011, 0.0009, 0.0218, 0.2077],
        [214_321.0, 252_117.0, 262_006.0, 272_000.0, 281_999.0, 300_001.0, 326_400.0],
        [-3.1415, -2.01, -1.0001, 0.0, 0.9999, 2.0, 3.1415],
        [-1234.5, -567.8, -12.3, -0.04, 0.04, 890.1, 16_543.2],
    ],
)
def test_any_regimes(drawn, diagnosed, tmp_path, edges):
    rng = np.random.default_rng(1)
    bins = tuple(
        Bin(name, low, high, float(rng.normal(0.0, 900.0)), "rad/s", 100, float(rng.choice([0.01, 0.5])))
        for name in ("speed", "yaw rate to the left", "load", "time since start")
        for low, high in pairwise(edges)
    )
    result = RegimeMap(bins, 0.01, 1000)
    draw(regimes(replace(diagnosed, at_base=result, at_end=result)), tmp_path / "r.png")
    assert not drawn.faults(drawn.figures[0])
