"""The report in a browser: it shows the recorded values, without errors and requests."""

import contextlib

import browser
import numpy as np
import pytest
import report_runs

import warpcontact as wc

pytestmark = [pytest.mark.slow, pytest.mark.browser]

READY = "window.warpcontact && window.warpcontact.ready"


@pytest.fixture(scope="module")
def crate(tmp_path_factory):
    return report_runs.run(tmp_path_factory.mktemp("crate") / "run")


@pytest.fixture(scope="module")
def file(crate, tmp_path_factory):
    return wc.report(crate, tmp_path_factory.mktemp("report") / "report.html")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    with browser.browser(tmp_path_factory.mktemp("chromium")) as page:
        yield page


@pytest.fixture
def opened(pages):
    """Opens a file; afterwards checks that there were no errors and no other requests."""

    @contextlib.contextmanager
    def open_file(path, *words, **options):
        url = path.resolve().as_uri()
        with pages(url, *words, **options) as page:
            page.wait_for(READY)
            yield page
            page.listen(0.3)
            assert page.errors == []
            assert page.requests == [url]

    return open_file


def state(page):
    """State of the replay, after it was drawn."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page.evaluate("window.warpcontact.state()")


def set_time(page, time):
    page.evaluate(
        "(() => { const slider = document.getElementById('replay-time'); "
        f"slider.value = {time}; slider.dispatchEvent(new Event('input')); }})()"
    )


def choose_env(page, env):
    page.evaluate(
        "(() => { const list = document.getElementById('replay-env'); "
        f"list.value = {env}; list.dispatchEvent(new Event('change')); }})()"
    )
    page.wait_for(f"window.warpcontact.state().env === {env}")


def places(seen, name):
    return np.array(next(figure["places"] for figure in seen["figures"] if figure["name"] == name))


def expected(run, env, time):
    """Recorded position of the crate, interpolated linearly between records."""
    position = run.series["crate.position"].sel(env=env)
    return np.array([np.interp(time, position["time"], position.sel(axis=axis)) for axis in "xyz"])


@pytest.mark.parametrize("size", [browser.DESKTOP, browser.PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_replayed_bodies_are_at_recorded_positions(size, dark, crate, file, opened):
    with opened(file, size, dark) as page:
        for env in (0, 3):
            choose_env(page, env)
            for time in (0.0, 0.2, 0.2025, 0.5):
                set_time(page, time)
                seen = state(page)
                assert seen["env"] == env
                assert seen["time"] == pytest.approx(time, abs=1e-6)
                # Quantized to 16 bits of a range of less than 1 m.
                np.testing.assert_allclose(places(seen, "hull")[0], expected(crate, env, time), atol=2e-5)
                np.testing.assert_allclose(places(seen, "ground")[0], 0.0, atol=1e-12)
        assert seen["calls"] > 0
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_replayed_force_arrows_are_visible_and_can_be_hidden(crate, file, opened):
    force = crate.series["feet.normal_force"].sel(env=0)
    row = int(force.max("item").argmax("time"))
    time = float(force["time"][row])
    with opened(file) as page:
        set_time(page, 0.0)
        assert state(page)["arrows"] == 0
        set_time(page, time)
        seen = state(page)
        assert seen["arrows"] == int((force[row] > 1e-3 * force.max()).sum())
        with_arrows = page.screenshot()
        page.click("document.getElementById('replay-arrows')")
        assert state(page)["arrows"] == 0
        assert page.screenshot() != with_arrows
        page.click("document.getElementById('replay-gaps')")
        assert not state(page)["gaps"]
        assert page.evaluate("getComputedStyle(document.getElementById('replay-legend')).display") == "none"


def test_replayed_areas_of_body_contact_are_visible_and_can_be_hidden(opened, tmp_path):
    box = {"type": "RoundedBox", "half_extents": [0.05, 0.05, 0.05]}
    settings = {
        "name": "box",
        "envs": 1,
        "duration": 0.05,
        "dt": 5e-4,
        "output": {"usd_envs": 0},
        # It falls onto the floor in 45 ms.
        "body": [{"name": "box", "mass": 1.0, "inertia": [2e-3] * 3, "position": [0, 0, 0.06]}],
        "shape": [{"name": "floor", "form": {"type": "Plane"}}, {"name": "cube", "body": "box", "form": box}],
        "material": [{"name": "rubber", "law": {"type": "ElasticFoundation", "stiffness": 2e6}}],
        "body_contact": [{"name": "touch", "first": "box", "second": "floor", "material": "rubber"}],
        "record": {"every": 5e-3, "sensors": ["touch.normal_force"]},
    }
    run = wc.Experiment.from_dict(settings).run(tmp_path / "run", device="cpu", progress=False)
    with opened(wc.report(run)) as page:
        set_time(page, 0.0)
        assert state(page)["patches"] == 0
        set_time(page, 0.05)
        assert state(page)["patches"] == 2
        with_area = page.screenshot()
        page.click("document.getElementById('replay-pressure')")
        assert state(page)["patches"] == 0
        assert page.screenshot() != with_area
        assert page.evaluate("document.getElementById('legend-pressure').hidden")


@pytest.mark.smoke
def test_replay_plays_to_the_end_and_stops(file, opened):
    with opened(file) as page:
        # At this speed the replay cannot end before the next action, even if drawing is slow.
        page.evaluate("document.getElementById('replay-speed').value = '0.01'")
        page.click("document.getElementById('replay-play')")
        page.wait_for("window.warpcontact.state().time > 0")
        assert state(page)["playing"]
        page.evaluate("document.getElementById('replay-speed').value = '1'")
        page.wait_for("!window.warpcontact.state().playing")
        assert state(page)["time"] == pytest.approx(0.5)


@pytest.mark.smoke
def test_replay_keys_match_the_help(file, opened):
    with opened(file) as page:

        def after(key, **more):
            page.key(key, **more)
            return state(page)

        assert after("ArrowRight")["record"] == 1
        assert after("End")["record"] == 100
        assert after("ArrowLeft")["record"] == 99
        assert after("Home")["record"] == 0
        page.key("]")
        page.wait_for("window.warpcontact.state().env === 1")
        page.key("[")
        page.wait_for("window.warpcontact.state().env === 0")
        page.key("5")
        page.wait_for("window.warpcontact.state().env === 5")
        page.key("g")
        assert not state(page)["gaps"]
        speed = state(page)["speed"]
        page.key("+")
        assert state(page)["speed"] > speed
        page.key(" ")
        page.wait_for("window.warpcontact.state().playing || window.warpcontact.state().time > 0")
        page.key(" ")
        page.key("?")
        assert page.evaluate("document.querySelector('dialog').open")
        page.click("document.querySelector('dialog button')")
        assert not page.evaluate("document.querySelector('dialog').open")
        before = state(page)
        page.evaluate("document.getElementById('environments-filter').focus()")
        assert after("ArrowRight")["record"] == before["record"]  # the cursor moves in the field


def test_replay_camera_rotates_and_resets(file, opened):
    with opened(file) as page:
        first = state(page)["camera"]
        x, y = page.place("document.getElementById('replay-canvas')")
        page.drag((x, y), (x + 120, y + 30))
        assert not np.allclose(state(page)["camera"], first, rtol=1e-3)
        page.click("document.getElementById('replay-fit')")
        np.testing.assert_allclose(state(page)["camera"], first, rtol=1e-6)


def test_replay_canvas_follows_the_window_size(file, opened):
    with opened(file) as page:
        page.call("Emulation.setDeviceMetricsOverride", width=700, height=600, deviceScaleFactor=3, mobile=False)
        canvas = "document.getElementById('replay-canvas')"
        # Two pixels per CSS pixel, and no more.
        page.wait_for(f"{canvas}.clientWidth < 700 && {canvas}.width === 2 * {canvas}.clientWidth")
        assert state(page)["canvas"] == page.evaluate(f"[{canvas}.clientWidth, {canvas}.clientHeight]")


@pytest.mark.smoke
def test_report_table_rows_are_sorted_filtered_and_replayed(crate, file, opened):
    rows = "[...document.querySelectorAll('#environments-table tbody tr')].map((row) => Number(row.dataset.env))"

    def search(page, text):
        page.evaluate(
            "(() => { const field = document.getElementById('environments-filter'); "
            f"field.value = {text!r}; field.dispatchEvent(new Event('input')); }})()"
        )
        return page.evaluate(rows)

    hardest = crate.outcome["hardest"].values
    with opened(file) as page:
        assert page.evaluate(rows) == list(range(6))
        head = "[...document.querySelectorAll('th button')].find((one) => one.textContent.startsWith('hardest'))"
        page.click(head)
        assert page.evaluate(rows) == np.argsort(hardest, kind="stable").tolist()
        page.click(head)
        assert page.evaluate(rows) == np.argsort(hardest, kind="stable")[::-1].tolist()
        middle = float(np.median(hardest))
        assert sorted(search(page, f"hardest > {middle}")) == np.flatnonzero(hardest > middle).tolist()
        assert search(page, "status = frozen") == search(page, "frozen") == [4]
        assert sorted(search(page, "1-3 status != frozen")) == [1, 2, 3]
        assert len(search(page, "nothing < 3")) == 6
        assert "no such column" in page.evaluate("document.getElementById('environments-count').textContent")
        search(page, "3")
        page.click("document.querySelector('#environments-table button.link')")
        page.wait_for("window.warpcontact.state().env === 3")
        assert page.evaluate("document.querySelectorAll('path.chosen[d^=M]').length") > 0
        assert page.evaluate("document.querySelector('svg g.chosen').dataset.env") == "3"


@pytest.mark.smoke
def test_report_theme_can_be_chosen(file, opened):
    background = "getComputedStyle(document.body).backgroundColor"
    with opened(file, dark=True) as page:
        dark = page.evaluate(background)
        page.click("document.getElementById('theme')")
        light = page.evaluate(background)
        assert light == "rgb(255, 255, 255)" != dark
        page.click("document.getElementById('theme')")
        assert page.evaluate(background) == dark


@pytest.mark.parametrize("width", [360, 390, 1280])
def test_report_page_fits_the_screen_width(width, tmp_path, opened):
    study = report_runs.changed(name="W" * 200, duration=0.01)
    run = report_runs.run(tmp_path / "run", study)
    with opened(wc.report(run), (width, 800)) as page:
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_report_without_webgl_shows_everything_but_the_replay(file, opened, pages):
    without = "HTMLCanvasElement.prototype.getContext = () => null;"
    with pages("about:blank#") as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source=without)
        page.go(file.resolve().as_uri())
        page.wait_for(READY)
        assert "shows no WebGL 2" in page.text()
        assert page.evaluate("document.querySelectorAll('#environments-table tbody tr').length") == 6
        assert page.errors == []


@pytest.mark.smoke
def test_report_without_javascript_shows_charts(file, pages):
    with pages(file.resolve().as_uri(), script=False) as page:
        assert "The replay needs JavaScript" in page.text()
        assert page.evaluate("document.querySelectorAll('svg .band').length") > 0


def test_replay_does_not_start_with_reduced_motion(file, opened):
    with opened(file, still=True) as page:
        assert page.evaluate("getComputedStyle(document.documentElement).scrollBehavior") == "auto"
        assert not state(page)["playing"]


@pytest.mark.parametrize(
    "hostile", ["</script><script>window.hacked = 1</script>", "<img src=x onerror=hacked=1>"]
)
def test_malicious_texts_run_no_script_in_the_report(hostile, tmp_path, opened):
    study = report_runs.changed(name=hostile, duration=0.01)
    run = report_runs.run(tmp_path / "run", study)
    run.summary["warnings"] = [hostile]
    run.summary["versions"] = {hostile: hostile}
    with opened(wc.report(run)) as page:
        assert page.evaluate("typeof window.hacked") == "undefined"
        assert page.evaluate("document.querySelectorAll('img').length") == 0
        assert hostile in page.evaluate("document.querySelector('h1').innerText")


@pytest.mark.smoke
def test_content_security_policy_blocks_scripts_and_requests(file, pages):
    with pages(file.resolve().as_uri()) as page:
        page.wait_for(READY)
        ran = page.evaluate(
            "(() => { const script = document.createElement('script'); script.textContent = 'window.ran = 1'; "
            "document.body.append(script); return window.ran; })()"
        )
        assert ran is None
        assert page.evaluate("fetch('https://example.com/').then(() => 'loaded', () => 'refused')") == "refused"
        page.listen(0.3)
        assert any("Content Security Policy" in error for error in page.errors)


def test_report_of_a_thousand_bodies_is_below_five_megabytes(tmp_path, opened):
    random = np.random.default_rng(5)
    study = {
        "envs": 1,
        "duration": 0.99,
        "dt": 1e-3,
        "output": {"usd_envs": 0},
        "bodies": [
            {
                "name": "grains",
                "mass": 1.0,
                "inertia": [0.01, 0.02, 0.03],
                "positions": random.uniform([-3, -3, 2], [3, 3, 6], (1000, 3)).tolist(),
                "linear_velocities": random.normal(size=(1000, 3)).tolist(),
                "angular_velocities": (4.0 * random.normal(size=(1000, 3))).tolist(),
            }
        ],
        "shape": [{"name": "grain", "body": "grains", "form": {"type": "Sphere", "radius": 0.08}}],
        "record": {"every": 1e-2},
    }
    run = report_runs.run(tmp_path / "run", study)
    path = wc.report(run)
    assert path.stat().st_size < 5e6
    with opened(path) as page:
        seen = state(page)
        assert seen["records"] == 100
        set_time(page, 0.5)
        seen = state(page)
        figure = next(figure for figure in seen["figures"] if figure["name"] == "grain")
        assert figure["count"] == 1000
        expected_positions = run.series["grains.position"].sel(env=0).isel(time=50).values[:4]
        # Quantized to 16 bits of a range of about 15 m.
        np.testing.assert_allclose(figure["places"], expected_positions, atol=3e-4)
