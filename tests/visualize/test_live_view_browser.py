"""The live view in a browser: pages animate, controls work, and no external requests are made."""

import contextlib
import io
import json

import numpy as np
import pytest
import sharded_runs
from browser import DESKTOP, PHONE, browser
from matplotlib.image import imread
from viewer_helpers import ball_on_ground, poll_until, viewing, wait_for_thread

import warpcontact as wc

pytestmark = [pytest.mark.slow, pytest.mark.browser]

HOSTILE = '<img src=x onerror="window.harmed=1"><script>window.harmed=1</script>'
# Viser's notification about a machine without a GPU covers the view and disappears by itself.
NOTE = "document.querySelector('.mantine-Notification-closeButton')"


@pytest.fixture(scope="module")
def open_page(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a run with a malicious name, and with data for arrows and colors."""
    folder = tmp_path_factory.mktemp("view")
    path = sharded_runs.study(folder)
    text = path.read_text().replace('"touch.status"]', '"touch.status", "touch.point", "touch.normal"]')
    path.write_text(f"name = '''{HOSTILE}{'n' * 120}'''\n{text}")
    wc.Experiment.from_toml(path).run(folder / "run", device="cpu", progress=False)
    return folder / "run"


def ready(page):
    """Waits until the page shows its content, without notifications of viser."""
    page.wait_for("document.querySelector('canvas') !== null && document.body.innerText.includes('Frame the')")
    # It appears after the first picture; software renderers are slow.
    page.wait_for(f"{NOTE} !== null || performance.now() > 15000")
    if page.evaluate(f"{NOTE} !== null"):
        page.click(NOTE)
        page.wait_for(f"{NOTE} === null")
    page.listen(1.0)


def picture(page):
    """The view to the left of the panel: RGB (row, column, 3) in 0…1."""
    page.listen(1.5)  # software rendering
    return imread(io.BytesIO(page.screenshot()))[:, :850, :3]


def labelled(label):
    """Expression for the input with a label: the first one in their common parent."""
    text = f"[...document.querySelectorAll('label')].find(e => e.innerText.trim() === {label!r})"
    return f"(e => {{ let i; while (!(i = e.querySelector('input'))) e = e.parentElement; return i; }})({text})"


def button(text):
    """Expression for the button with a text."""
    return f"[...document.querySelectorAll('button')].find(e => e.innerText.trim() === {text!r})"


def check_harmless(page, url):
    """Checks that there were no errors and no external requests."""
    assert page.errors == []
    assert page.requests
    assert {address.split("://")[1].split("/")[0] for address in page.requests} == {url.split("://")[1]}
    assert page.evaluate("window.harmed === undefined")
    assert page.evaluate("document.querySelectorAll('img[src=x]').length") == 0


@pytest.mark.smoke
def test_view_page_replays_a_run(run, open_page):
    with viewing(run) as show, open_page(show.server.url) as page:
        ready(page)
        assert "<img src=x" in page.text()
        first = picture(page)
        assert np.ptp(first) > 0.3, "nothing is drawn"

        # Time slider.
        slider = "document.querySelector('[role=slider]')"
        start = page.place(slider)
        left, width = page.evaluate(f"(r => [r.x, r.width])({slider}.parentElement.getBoundingClientRect())")
        page.drag(start, (left + 0.5 * width, start[1]))
        poll_until(lambda: 80 <= show.record <= 120)
        page.wait_for(f"document.body.innerText.includes('record {show.record + 1} of 201')")
        assert float(page.evaluate(f"{slider}.ariaValueNow")) == pytest.approx(show.time_input.value, abs=1e-6)
        assert np.abs(picture(page) - first).max() > 0.3, "what moved is drawn where it was"

        # The button for the environment; the camera follows its ball.
        (client,) = show.server.get_clients().values()
        place, look_at = client.camera.position, client.camera.look_at
        page.click(button("Next"))
        poll_until(lambda: show.picker.env == 1)
        wait_for_thread(show)
        balls = wc.open_run(run).recording["ball.position"].values[[0, show.record], [0, 1]]
        np.testing.assert_allclose(client.camera.look_at - look_at, balls[1] - balls[0], atol=1e-6)
        np.testing.assert_allclose(client.camera.position - place, balls[1] - balls[0], atol=1e-6)
        page.wait_for("document.body.innerText.includes('ACTIVE')")
        mass = float(wc.open_run(run).params["ball.mass"].sel(env=1))
        page.wait_for(f"document.body.innerText.includes('{mass:.6g} kg')")

        # Play and pause.
        page.click(button("First"))
        poll_until(lambda: show.record == 0)
        show.speed = 0.01
        page.click(button("Play"))
        poll_until(lambda: show.record > 1)
        page.click(button("Pause"))
        poll_until(lambda: not show.playing)
        assert show.problem == ""
        check_harmless(page, show.server.url)


def test_view_page_draws_arrows_and_colors(open_page):
    simulation = ball_on_ground()
    simulation.step(400)
    with viewing(simulation) as show, open_page(show.server.url) as page:
        ready(page)
        show.length_input.value = 3.0
        wait_for_thread(show)
        arrow = picture(page)
        page.click(labelled("Forces"))
        poll_until(lambda: not show.stage.forces)
        bare = picture(page)
        gone = np.abs(arrow - bare).max(axis=2) > 0.1
        # An upward arrow from the ball at the center of the picture: higher than wide.
        rows, columns = np.nonzero(gone)
        assert np.ptp(rows) > 2 * np.ptp(columns) > 0
        red, green, blue = np.median(arrow[gone], axis=0)
        assert red > green > blue
        page.click(labelled("Gaps"))
        poll_until(lambda: show.stage.gaps)
        colored = picture(page)
        ball = np.abs(colored - bare).max(axis=2) > 0.1
        # In contact: the color changes from blue to pale red.
        before, after = np.median(bare[ball], axis=0), np.median(colored[ball], axis=0)
        assert before[2] > before[0]
        assert after[0] > after[2]
        page.wait_for("document.body.innerText.includes('−0.00')")  # legend
        check_harmless(page, show.server.url)


@pytest.mark.smoke
def test_view_page_changes_a_parameter_of_a_running_simulation(tmp_path, open_page):
    path = sharded_runs.study(tmp_path, envs=3)
    with viewing(path) as show, open_page(show.server.url) as page:
        model = show.simulation.model
        ready(page)
        page.click(button("Play"))
        poll_until(lambda: show.simulation.time > 0.1)
        page.click(button("Next"))
        poll_until(lambda: show.picker.env == 1)

        def enter(text, answer):
            # A field that was just recreated may lose typed text, so it is typed again.
            for _ in range(5):
                page.click(labelled("ball.mass"))
                page.evaluate(f"{labelled('ball.mass')}.select()")
                page.write(text)
                page.key("Enter", number=13, text="\r")
                with contextlib.suppress(TimeoutError):
                    return page.wait_for(f"document.body.innerText.includes({json.dumps(answer)})", timeout=20.0)
            raise TimeoutError(answer)

        enter("heavy", "ball.mass must be numbers")
        before = show.simulation.time
        poll_until(lambda: show.simulation.time > before)
        enter("25", "environment 1: ball.mass = 25")
        assert model["ball.mass"][1] == 25.0
        assert (np.delete(model["ball.mass"], 1) < 2.0).all()
        assert "must be numbers" not in page.text()
        before = show.simulation.time
        poll_until(lambda: show.simulation.time > before)
        # The displayed energy is that of the new mass.
        page.click(button("Pause"))
        poll_until(lambda: not show.playing)
        wait_for_thread(show)
        energy = model.sensor("scene.kinetic_energy")[1]
        speed = np.linalg.norm(model.sensor("ball.linear_velocity")[1])
        spin = np.linalg.norm(model.sensor("ball.angular_velocity")[1])
        # Single precision.
        assert energy == pytest.approx(0.5 * 25.0 * speed**2 + 0.5 * 4e-3 * spin**2, rel=1e-5)
        page.wait_for(f"document.body.innerText.includes('{energy:.6g} J')")
        steps = show.simulation.steps
        page.click(button("Step"))
        poll_until(lambda: show.simulation.steps == steps + 1)
        check_harmless(page, show.server.url)


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_view_page_fits_any_screen_size(run, size, open_page):
    with viewing(run) as show, open_page(show.server.url, size=size) as page:
        ready(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        width, height = page.evaluate(
            "(r => [r.width, r.height])(document.querySelector('canvas').getBoundingClientRect())"
        )
        assert (width, height) == size
        check_harmless(page, show.server.url)
