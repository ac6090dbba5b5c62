"""Parts of a report: packed arrays, charts, escaped texts, and a million environments."""

import base64
import dataclasses
import re
import tracemalloc
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from warpcontact.drawing.drawing import Shape, ball
from warpcontact.model.health import Health
from warpcontact.scene.contact_coupling import CouplingReport
from warpcontact.scene.status import EnvironmentStatus, FailureCause
from warpcontact.validation import number_format
from warpcontact.visualize.report import chart, contacts, environments, markup, outcomes, packing, replay, series
from warpcontact.visualize.report.environments import columns_of
from warpcontact.visualize.report.outcomes import choose
from warpcontact.visualize.report.packing import Pack


def unpacked(pack):
    """Unpacks like ``web/src/unpack.js``."""
    content = pack.content()
    data = zlib.decompress(base64.b64decode(content["data"]))
    place, found = 0, []
    for about in content["arrays"]:
        if about["type"] == "same":
            found.append(found[about["of"]])
            continue
        shape = tuple(about["shape"])
        size = int(np.prod(shape))
        if about["type"] == "float":
            found.append(np.frombuffer(data, "<f4", size, place).reshape(shape))
            place += 4 * size
            continue
        width = {"short": 2, "index": 4}[about["type"]]
        planes = np.frombuffer(data, np.uint8, width * size, place).reshape(width, size).astype(np.uint64)
        differences = sum(plane << np.uint64(8 * i) for i, plane in enumerate(planes))
        place += width * size
        if about["type"] == "index":
            found.append((np.cumsum(differences) % 2**32).reshape(shape))
            continue
        rows = differences.reshape(-1, shape[0])
        whole = (np.cumsum(rows, axis=1) % 2**16).T.reshape(shape).astype(np.float64)
        values = np.array(about["low"]) + np.array(about["step"]) * whole
        found.append(np.where(whole == 65535, np.nan, values))
    assert place == len(data)
    return found


def test_packed_series_round_trip_within_half_a_step():
    random = np.random.default_rng(1)
    values = np.cumsum(random.normal(size=(50, 7, 3)), axis=0) * [1.0, 1e-3, 1e3]
    values[3, 2] = np.nan
    values[:, :, 2] = np.where(np.isfinite(values[:, :, 2]), 5.0, np.nan)  # no extent along one axis
    pack = Pack()
    pack.series(values)
    (found,) = unpacked(pack)
    step = np.nanmax(values, axis=(0, 1)) - np.nanmin(values, axis=(0, 1))
    # Half a step of 65534, and rounding.
    assert (np.nan_to_num(np.abs(found - values)) < 0.51 * step / 65534 + 1e-12).all()
    assert (np.isnan(found) == np.isnan(values)).all()


def test_packed_series_beyond_16_bits_are_exact():
    values = np.array([[[0.0, 0.0, 0.0]], [[1e6, 0.25, 1.0]]])
    pack = Pack()
    pack.series(values, finest=1e-3)
    np.testing.assert_array_equal(unpacked(pack)[0], values)


def test_packed_rotations_round_trip():
    random = np.random.default_rng(2)
    turns = random.normal(size=(40, 5, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    pack = Pack()
    pack.rotations(turns)
    (found,) = unpacked(pack)
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    # cos(half the angle between them): each of four components has an error of up to half a step of 2/65534.
    assert np.abs(np.sum(found / length * turns, axis=-1)).min() > 1.0 - 1e-8
    # consecutive quaternions have equal sign, for interpolation
    assert (np.sum(found[1:] * found[:-1], axis=-1) > -1e-4).all()


def test_packed_indices_round_trip_and_equal_arrays_are_stored_once():
    faces = np.random.default_rng(3).integers(0, 100_000, (500, 3)).astype(np.int32)
    pack = Pack()
    pack.indices(faces)
    pack.exact(np.arange(6.0).reshape(2, 3))
    size = pack.raw
    pack.indices(faces)
    assert pack.raw == size
    first, _, again = unpacked(pack)
    np.testing.assert_array_equal(first, faces)
    np.testing.assert_array_equal(again, faces)


def test_large_meshes_are_simplified_in_place():
    n = 400
    x, y = np.meshgrid(np.linspace(0, 4, n), np.linspace(0, 4, n))
    vertices = np.stack([x, y, np.sin(x)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    faces = np.concatenate([corner[:, None] + [0, 1, n], corner[:, None] + [1, n + 1, n]]).astype(np.int32)
    colors = np.zeros((len(faces), 3))
    drawn = packing.drawable_shape(Shape(vertices, faces, colors), 1)
    assert len(drawn.colors) == len(drawn.faces) <= packing.TRIANGLES < len(faces)
    a, b, c = (drawn.vertices[drawn.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    fine = [vertices[faces[:, i]] for i in range(3)]
    expected = np.linalg.norm(np.cross(fine[1] - fine[0], fine[2] - fine[0]), axis=1).sum() / 2
    assert area == pytest.approx(expected, rel=0.02)  # points move by up to one of about 300 cells along a side
    assert len(packing.drawable_shape(ball(), 1).faces) > len(packing.drawable_shape(ball(), 1000).faces)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1234.5678, "1235"),
        (-0.00012345678, "−0.0001235"),
        (1.5e-7, "1.5×10⁻⁷"),
        (-2.0e12, "−2×10¹²"),
        (float("nan"), "–"),
        (float("-inf"), "−∞"),
    ],
)
def test_numbers_are_formatted_with_few_digits(value, text):
    assert number_format.number(value) == text


@pytest.mark.parametrize(
    ("unit", "largest", "expected"),
    [
        ("m", 0.02, (1e3, "mm")),
        ("N", 3e4, (1e-3, "kN")),
        ("N/m", 3e7, (1e-6, "MN/m")),
        ("m²", 2e-5, (1e6, "10⁻⁶ m²")),
        ("s", 2e4, (1e-3, "10³ s")),
        ("kg", 2e4, (1e-3, "10³ kg")),
        ("-", 0.002, (1e3, "10⁻³")),
        ("m", 5.0, (1.0, "m")),
        ("m", 0.0, (1.0, "m")),
        ("m", 1e-315, (1.0, "m")),
        ("m", float("inf"), (1.0, "m")),
    ],
)
def test_units_are_scaled_to_the_data(unit, largest, expected):
    factor, text = number_format.scaled(unit, largest)
    assert factor == pytest.approx(expected[0])
    assert text == expected[1]


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (0.0, 1.0),
        (-3.7, 12.1),
        (1e-9, 3e-9),
        (1e6, 1e6 + 1.0),
        (5.0, 5.0),
        (0.0, 0.0),
        (0.0, 5e-324),
        (-1e30, 1e30),
    ],
)
def test_chart_axes_have_few_distinct_marks(low, high):
    axis = chart.horizontal(low, high, "m")
    marks = axis.marks()
    assert 2 <= len(marks) <= 8
    places = [place for place, _ in marks]
    assert min(places) >= chart.LEFT - 0.1
    assert max(places) <= chart.WIDTH - chart.RIGHT + 0.1
    assert len({text for _, text in marks}) == len(marks)  # all differ


@pytest.mark.parametrize(
    ("low", "high", "precision", "scale"),
    [
        (-3e-17, 2e-17, 2.2e-16, 5.0),  # for energies of 5 J
        (2e-16, 2e-16, 2.2e-16, 1.0),
        (1.0, 1.0 + 4e-16, 2.2e-16, 1.0),
        (0.1, 0.1 + 1e-8, 1.2e-7, 0.1),
        (-2e-5, -2e-5, 1.2e-7, 0.0),
    ],
)
def test_rounding_noise_is_drawn_flat(low, high, precision, scale):
    axis = chart.vertical(*series.visible_range(low, high, precision, scale), "J")
    drawn = axis.place(np.array([low, high]))
    assert np.ptp(drawn) < 0.05  # of a pixel
    assert chart.TOP < drawn.min() <= drawn.max() < chart.HEIGHT - chart.BOTTOM


@pytest.mark.parametrize(
    ("low", "high", "precision", "scale"),
    [(0.0, 1e-9, 1.2e-7, 10.0), (1.0, 1.0001, 1.2e-7, 1.0), (1e-17, 3e-17, 2.2e-16, 3e-17), (0.0, 1.0, 0.0, 1.0)],
)
def test_variation_above_rounding_fills_its_chart(low, high, precision, scale):
    assert series.visible_range(low, high, precision, scale) == (low, high)


def test_curves_have_gaps_at_non_finite_samples():
    x = np.arange(6.0)
    drawn = chart.polyline(x, np.array([0.0, 1.0, np.nan, 2.0, np.inf, 3.0]), "curve")
    assert drawn.count("M") == 3
    assert "nan" not in drawn
    assert "inf" not in drawn


def test_texts_are_escaped_in_markup_and_data():
    malicious = "\"'><script>&\u2028\x00"
    drawn = markup.element("p", malicious, title=malicious)
    assert drawn == '<p title="{0}">{0}</p>'.format("&quot;&#x27;&gt;&lt;script&gt;&amp;\u2028\ufffd")
    block = markup.data_block("x", {"a": malicious, malicious: float("nan"), "b": [float("inf"), 1.5]})
    inner = block.partition(">")[2].rpartition("<")[0]
    assert not set(inner) & set("<>&\u2028\x00")
    assert inner.isascii()
    assert "NaN" not in inner
    assert "Infinity" not in inner


def cells(content):
    """Cell texts of tables, row by row."""
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", content)]


def test_report_describes_contact_couplings():
    report = CouplingReport(
        name="<b>fender",
        effective_area=np.array([0.0, 0.2, 0.3]),
        minimum_distance=np.array([np.nan, 0.01, -0.002]),
        effective_range=np.full(3, 0.02),
        impact=None,
        first_env=0,
    )
    content = contacts.couplings_section([report])
    expected = ["<bdi>&lt;b&gt;fender</bdi>", "2 of 3", "−0.002 to 0.01", "0.2 to 0.3", "1", "–"]
    assert cells(content)[1] == expected
    none = dataclasses.replace(report, minimum_distance=np.full(3, np.nan))
    assert cells(contacts.couplings_section([none]))[1][1:4] == ["0 of 3", "–", "–"]
    assert contacts.couplings_section([]) is None


def test_loop_drawing_and_caption_include_late_peaks():
    seconds = np.linspace(0.0, 1.0, 10_001)
    depth = 1e-3 * np.abs(np.sin(40.0 * seconds))
    force = 1e5 * depth * (1.0 + 0.2 * np.cos(40.0 * seconds))
    force[9000] = 777.77
    values = np.stack([np.zeros_like(force), force], axis=1)  # another point without a force
    data = xr.Dataset(
        {
            "touch.gap": (("time", "env", "item"), np.repeat(-depth[:, None, None], 2, axis=2)),
            "touch.normal_force": (("time", "env", "item"), values[:, None]),
        },
        coords={"time": seconds, "env": [3]},
    )
    content = contacts.loops_section(data, [3])
    assert "largest force 777.77\u202fN at 0.9\u202fs in environment 3; largest penetration 1\u202fmm" in content
    path = re.search(r'd="M([^"]*)" class="loop"', content)[1]
    up = np.array(path.split(), dtype=float)[1::2]
    assert len(up) <= contacts.SAMPLES
    assert up.min() == pytest.approx(chart.vertical(0.0, 1.05 * 777.77, "N").place(777.77), abs=0.06)


def test_loop_of_a_short_impact_is_kept_before_a_long_rest():
    angle = np.linspace(0.0, np.pi, 200)
    depth = np.append(np.sin(angle), np.full(20_000, 0.1))
    force = np.append(np.sin(angle) * (1.0 + 0.5 * np.cos(angle)), np.full(20_000, 0.1))
    data = xr.Dataset(
        {
            "touch.penetration": (("time", "env"), depth[:, None]),
            "touch.normal_force": (("time", "env"), force[:, None]),
        },
        coords={"time": 1e-4 * np.arange(len(depth)), "env": [0]},
    )
    (loop,) = contacts._loops(data, "touch.penetration", "touch.normal_force")

    def area(depth, force):
        return np.trapezoid(force, depth)

    assert len(loop.force) <= contacts.SAMPLES
    assert area(loop.penetration, loop.force) == pytest.approx(area(depth, force), rel=1e-2)


def test_replayed_records_include_force_peaks():
    force = np.zeros((3000, 2, 5))
    peaks = [17, 1234, 2500, 2998]
    force[peaks, [0, 1, 1, 0], [4, 2, 0, 0]] = 10.0
    data = xr.Dataset({"touch.normal_force": (("time", "env", "item"), force)})
    scene = SimpleNamespace(contacts=[SimpleNamespace(name="touch")], shape_contacts=[], body_contacts=[])
    rows = replay._frames(data, scene, 256)
    assert {0, 2999, *peaks} <= set(rows)
    assert len(rows) <= 256
    assert np.diff(rows).max() < 3000 / 127 + 1
    assert (
        replay._frames(data.drop_vars("touch.normal_force").assign_coords(time=range(3000)), scene, 256).size
        == 256
    )
    assert replay._frames(data, scene, 5000).size == 3000


def test_report_lists_failed_stopped_and_reset_environments():
    status = np.array([EnvironmentStatus.ACTIVE, EnvironmentStatus.FROZEN, EnvironmentStatus.STOPPED], int)
    health = Health.of(
        status,
        np.array([FailureCause.NONE, FailureCause.TOO_FAR, FailureCause.NONE], int),
        np.array([1.0, 0.25, 0.5]),
    )
    stops = {"flag_values": [0, 1], "flag_meanings": "landed <tipped>"}
    outcome = xr.Dataset({"stopped_by": ("env", [-1, -1, 1], stops), "resets": ("env", [0, 0, 3])})
    content = environments.quarantine_section(health, outcome)
    rows = cells(content)
    assert rows[1][1:] == ["0.25\u202fs", "a body exceeded scene.max_distance"]
    assert 'data-replay="1"' in rows[1][0]
    assert rows[-1] == ["<bdi>&lt;tipped&gt;</bdi>", "1"]
    assert "1 environment failed and restarted, 3 times in total." in content
    good = Health.of(np.zeros(2, int) + EnvironmentStatus.ACTIVE, np.zeros(2, int), np.ones(2))
    assert "No environment failed." in environments.quarantine_section(good, outcome[["resets"]] * 0)


# A million environments


@pytest.fixture(scope="module")
def million():
    envs = 1_000_000
    random = np.random.default_rng(4)
    status = np.zeros(envs, np.int8)
    status[::1000] = EnvironmentStatus.FROZEN
    flags = {"flag_values": list(map(int, EnvironmentStatus))}
    flags["flag_meanings"] = " ".join(one.name for one in EnvironmentStatus)
    return xr.Dataset(
        {
            "peak": ("env", random.normal(size=envs), {"units": "N", "long_name": "peak"}),
            "place": (("env", "axis"), random.normal(size=(envs, 3)), {"units": "m"}),
            "status": ("env", status, flags),
        },
        coords={"env": np.arange(envs), "axis": ["x", "y", "z"]},
    )


def test_report_of_a_million_environments_has_a_capped_table(million):
    tracemalloc.start()
    spreads, more = outcomes.make_spreads(million)
    health = Health.of(million["status"].values, np.ones(10**6, int), np.zeros(10**6), million["env"].values)
    choice = choose(None, million["env"].values, health, spreads)
    params = million[["place"]].rename(place="start")
    content, data = environments.table_section(params, million, [*choice.envs, *map(int, health.frozen)])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert more == 0
    good = million["peak"].values[million["status"].values == 0]
    assert f"{np.median(good):.4g}".replace("-", "−") in spreads[0].row
    assert len(data["env"]) == environments.ROWS
    assert set(choice.envs) <= set(data["env"])
    assert "2\u202f000 of 1\u202f000\u202f000 environments" in content
    assert "warpcontact export" in content
    # A few copies of one outcome of 8 MB, not of all outcomes.
    assert peak < 40 * 8 * 10**6


def test_shown_environments_include_first_failed_and_extreme_ones(million):
    small = million.isel(env=slice(500, 2500))
    spreads, _ = outcomes.make_spreads(small)
    health = Health.of(small["status"].values, np.ones(2000, int), np.zeros(2000), small["env"].values)
    choice = choose(None, small["env"].values, health, spreads)
    assert choice.envs[0] == 500
    assert {1000, 2000, *range(500, 516)} <= set(choice.envs)
    good = small["peak"].where(small["status"] == 0)
    assert int(good["env"][int(good.argmax("env"))]) in choice.envs
    with pytest.raises(ValueError, match="environment 3 has no results to report; there are: 500 to 2499"):
        choose([500, 3], small["env"].values, health, spreads)
    with pytest.raises(ValueError, match="envs must name at least one"):
        choose([], small["env"].values, health, spreads)
    with pytest.raises(ValueError, match="envs must be environment numbers, got 'a'"):
        choose(["a"], small["env"].values, health, spreads)


def test_equal_items_are_one_column_and_large_sets_none():
    data = xr.Dataset(
        {
            "mu": (("env", "item"), np.repeat([[0.1], [0.2]], 500, axis=1)),
            "gaps": (("env", "item"), np.arange(1000.0).reshape(2, 500)),
            "few": (("env", "item_2"), np.arange(4.0).reshape(2, 2)),
        },
        coords={"env": [0, 1]},
    )
    assert [column.name for column in columns_of(data)] == ["mu", "few.0", "few.1"]
