# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures: valid, the same bytes twice, honest about peaks, and clear where matplotlib is not installed."""

import struct
import sys
import zlib

import numpy as np
import pytest

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.estimator.drives import ramp_and_hold, run_drive, simulate
from trackres_ros.learning.columns import columns_of
from trackres_ros.learning.gate import SHAPE
from trackres_ros.learning.parameters import VEHICLES_OWN, learnables
from trackres_ros.output.plots import estimate_figure
from trackres_ros.output.style import picture, thin_out
from trackres_ros.vehicle import load_any

pytest.importorskip("matplotlib")


def png_size(path):
    """Width and height of a PNG whose every chunk has its right checksum."""
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    place, kinds = 8, []
    while place < len(content):
        length, kind = struct.unpack(">I4s", content[place : place + 8])
        body = content[place + 4 : place + 8 + length]
        assert struct.unpack(">I", content[place + 8 + length : place + 12 + length])[0] == zlib.crc32(body)
        kinds.append(kind)
        place += 12 + length
    assert kinds[0] == b"IHDR"
    assert kinds[-1] == b"IEND"
    return struct.unpack(">II", content[16:24])


@pytest.fixture(scope="module")
def estimate(reference):
    drive = ramp_and_hold(10.0, 20.0, 300.0, 0.05)
    rows = run_drive(reference, drive)
    return drive.time_s, {name: rows[:, i] for name, i in reference.column_index.items()}


@pytest.fixture(scope="module")
def plain(estimate, tmp_path_factory):
    """The bytes of its picture."""
    path = tmp_path_factory.mktemp("plain") / "p.png"
    estimate_figure(*estimate, "drive", path=path)
    assert png_size(path) == (990, 792)
    return path.read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        {"wind_nm": lambda wind: 2.0 * wind},
        {"belt_degc/front_left": lambda belt: belt + 5.0},
        {"measured_torque_nm": lambda torque: np.where(np.arange(len(torque)) % 100 == 0, 20.0, np.nan)},
    ],
    ids=["wind", "belt", "measured torque"],
)
def test_other_data_and_measurements_show(estimate, plain, tmp_path, change):
    time_s, columns = estimate
    changed = {**columns, **{name: value(columns[name]) for name, value in change.items()}}
    estimate_figure(time_s, changed, "drive", path=tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes() != plain


def test_a_channel_without_measurements_changes_nothing(estimate, plain, tmp_path):
    time_s, columns = estimate
    others = {name: series for name, series in columns.items() if name != "measured_torque_nm"}
    estimate_figure(time_s, others, "drive", path=tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes() == plain


@pytest.mark.parametrize("title", ["drive", ", ".join(f"2026-02-03_vehicle_17_part_{i}.mcap" for i in range(40))])
def test_a_replay_can_be_read(estimate, drawn, tmp_path, title):
    time_s, columns = estimate
    estimate_figure(time_s, columns, title, path=tmp_path / "p.png")
    assert not drawn.faults(drawn.figures[0])


@pytest.mark.parametrize("name", ["a $b$ c", r"$\frac$ \_", "_$_{^$", "測定 一", "% # & <b>"])
def test_any_name_gives_the_picture_and_is_drawn_as_it_is(estimate, drawn, tmp_path, name):
    time_s, columns = estimate
    belt = columns["belt_degc/front_left"]
    named = {**{k: v for k, v in columns.items() if "/" not in k}, f"belt_degc/{name}": belt, "belt_degc/other": belt + 9.0}
    estimate_figure(time_s, named, name, path=tmp_path / f"{name.partition('/')[0]}.png")
    (figure,) = drawn.figures
    assert not drawn.faults(figure)
    assert figure.get_suptitle() == name
    assert not figure._suptitle.get_parse_math()


def test_a_logarithmic_axis_is_labelled_without_maths(drawn, tmp_path):
    with picture(tmp_path / "l.svg", 3.0, 3.0) as figure:
        figure.subplots().loglog([0.01, 1000.0], [2.0, 4.0])
    assert "<text" in (text := (tmp_path / "l.svg").read_text())
    assert ">0.01<" in text
    assert "mathdefault" not in text
    assert not drawn.faults(drawn.figures[0])


@pytest.mark.usefixtures("undrawn")
def test_lines_of_many_assemblies_differ(tmp_path):
    columns = {"speed_mps": np.ones(5), "resistance_torque_nm": np.ones(5)}
    columns |= {f"belt_degc/{i}": np.full(5, 10.0 * i) for i in range(16)}
    lines = estimate_figure(np.arange(5.0), columns, "t", path=tmp_path / "a.png").axes[2].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 16


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("vehicle", ["xgd24d", "ztbus_hess19"])
def test_all_learned_values_and_the_driving_are_drawn(tmp_path, vehicle):
    """The driving by belt temperature, or by load where there are no belts."""
    description = load_any(vehicle)
    own = [item for item in learnables(description) if item.state in VEHICLES_OWN]
    shown = ("speed_mps", "resistance_torque_nm", "ambient_degc", *(f"belt_degc/{item.name}" for item in description.assemblies))
    columns = dict.fromkeys((*shown, *(name for item in own for name in columns_of(item))), np.ones(5))
    seconds = np.zeros(SHAPE)
    seconds[1, :, 2] = 7.0
    figure = estimate_figure(np.arange(5.0), columns, "t", seconds, tmp_path / "a.png")
    axes = {item.get_ylabel(): item for item in figure.axes}
    assert len(axes["learned, over the first"].lines) == len(own)
    driving = axes["speed [% of greatest]"]
    of_x = ("learned from: belt [°C]", "< 15") if shown[3:] else ("learned from: load [% of nominal]", "< 90")
    assert (driving.get_xlabel(), driving.get_xticklabels()[0].get_text()) == of_x
    assert [text.get_text() for text in driving.texts if text.get_text() != "0 s"] == (["7 s"] * 4 if shown[3:] else ["28 s"])


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("rows", [100, 9000])
@pytest.mark.parametrize("then_s", [700.0, -1900.0])
def test_no_line_or_band_crosses_a_gap(tmp_path, rows, then_s):
    """Nor a step back."""
    time = np.arange(rows) * 0.1
    time[rows // 3 :] += 500.0
    time[rows // 2 :] += then_s
    in_order = np.sort(time)
    ends = [(in_order[i], in_order[i + 1]) for i in np.flatnonzero(np.diff(in_order) > 10.0)]
    assert len(ends) == 2
    names = ("speed_mps", "resistance_torque_nm", "resistance_std_nm", "bearing_nm", "belt_degc", "ambient_degc")
    names += ("learned_drag_coefficient", "learned_drag_coefficient_std")
    figure = estimate_figure(time, {name: np.sin(time) + 2.0 for name in names}, "gaps", path=tmp_path / "g.png")
    for axes in figure.axes:
        assert axes.lines
        for x in (line.get_xdata() for line in axes.lines):
            for begin, end in ends:
                assert not ((np.fmin(x[:-1], x[1:]) <= begin) & (np.fmax(x[:-1], x[1:]) >= end)).any()
                assert np.nanmax(x[x < end]) > begin - 5.0
        for band in axes.collections:
            for x in (path.vertices[:, 0] for path in band.get_paths()):
                assert not any(x.min() <= begin and x.max() >= end for begin, end in ends)


def test_it_draws_the_same_bytes_whatever_the_user_set_up(estimate, plain, tmp_path):
    import matplotlib

    with matplotlib.rc_context({"font.size": 20.0, "lines.linewidth": 5.0, "axes.facecolor": "black", "savefig.dpi": 30}):
        estimate_figure(*estimate, "drive", path=tmp_path / "dark.png")
        assert matplotlib.rcParams["font.size"] == 20.0
    assert (tmp_path / "dark.png").read_bytes() == plain


def test_a_simulation_draws_from_its_few_columns(reference, tmp_path):
    series = simulate(reference, ramp_and_hold(10.0, 20.0, 60.0, 0.5))
    estimate_figure(series["time_s"], series, "simulated", path=tmp_path / "s.png")
    assert png_size(tmp_path / "s.png") == (990, 792)


@pytest.mark.parametrize(
    "damage",
    [
        lambda time_s, columns: (time_s[:0], {}),
        lambda time_s, columns: (time_s, {**columns, "wind_nm": columns["wind_nm"][:-1]}),
    ],
)
def test_what_cannot_be_drawn_is_refused(estimate, tmp_path, damage):
    time_s, columns = damage(*estimate)
    with pytest.raises(InputError, match="allowed"):
        estimate_figure(time_s, columns, "drive", path=tmp_path / "bad.png")
    assert not (tmp_path / "bad.png").exists()


def test_without_matplotlib_it_says_what_to_install(estimate, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match="pip install matplotlib"):
        estimate_figure(*estimate, "drive", path=tmp_path / "p.png")


def test_importing_plots_does_not_import_matplotlib(tmp_path):
    import subprocess

    code = "import sys, trackres_ros.output.plots; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_thinned_line_keeps_peaks_ends_and_gaps():
    x = np.arange(100_003.0)
    y = np.sin(x / 5000.0)
    y[40_000], y[70_001] = 9.0, -9.0
    y[50_000:60_000] = np.nan
    kept_x, kept_y = thin_out(x, y, point_count=1000)
    assert len(kept_x) <= 1000
    assert (np.diff(kept_x) > 0).all()
    assert np.nanmax(kept_y) == 9.0
    assert kept_x[np.nanargmax(kept_y)] == 40_000
    assert np.nanmin(kept_y) == -9.0
    assert np.isnan(kept_y[(kept_x > 50_200) & (kept_x < 59_800)]).all()
    assert kept_x[0] < 201
    assert kept_x[-1] > 99_800
    assert np.array_equal(kept_y, y[kept_x.astype(int)], equal_nan=True)


def test_a_short_line_is_left_as_it_is():
    x, y = np.arange(5.0), np.array([1.0, np.nan, 3.0, 2.0, 2.0])
    kept_x, kept_y = thin_out(x, y)
    assert np.array_equal(kept_x, x)
    assert np.array_equal(kept_y, y, equal_nan=True)
