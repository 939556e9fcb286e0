"""Playing in headless Chromium: keys, touch, recording, a lost connection."""

from pathlib import Path
from typing import Any

from magical.demos import Dataset
from magical.demos.summary import replay
from tests.web.browser import Tab
from tests.web.driving import names_and_focus, play_expert, text_of
from tests.web.serving import RunningServer


def test_an_episode_is_played_with_keys_kept_and_found(
    slow: None, tab: Tab, server: RunningServer, dataset: Path
) -> None:
    tab.evaluate("element('name').value = 'Ada'; element('seed').value = 3")
    tab.evaluate("element('choose').requestSubmit()")
    tab.wait_for("latest.seed === 3")
    play_expert(tab, server)
    assert text_of(tab, "score") == "1.00"
    assert "score 1.00. Keep this episode?" in text_of(tab, "prompt-text")
    tab.tap("k")
    tab.wait_for("latest.kept === 1")
    assert text_of(tab, "connection") == "Recording; 1 kept"
    (trajectory,) = Dataset.open(dataset).filter(demonstrator="Ada", min_score=1.0)
    assert (trajectory.seed, trajectory.score) == (3, 1.0)
    assert replay(trajectory).departure == 0.0
    assert tab.browser.problems == []


def test_keys_show_the_last_action_and_start_over(tab: Tab) -> None:
    assert text_of(tab, "seconds") == "5.0 s"
    tab.key("ArrowUp", down=True)
    tab.key(" ", down=True)
    tab.wait_for("element('action').textContent === 'forward + grip'")
    lit = "[...document.querySelectorAll('[data-lit]')].map((one) => one.dataset.control).join()"
    assert tab.evaluate(lit) == "forward,grip"
    tab.tap("p")
    tab.wait_for("latest.phase === 'paused'")
    tab.tap("p")
    tab.wait_for("latest.phase === 'playing'")
    tab.tap("r")
    tab.wait_for("latest.phase === 'ready' && latest.steps === 0")
    assert tab.browser.problems == []


def test_typing_in_a_field_does_not_steer(tab: Tab) -> None:
    tab.evaluate("element('name').focus()")
    for key in ("r", " ", "k"):
        tab.tap(key)
    tab.tap("ArrowUp")
    assert tab.evaluate("element('name').value") == "r k"
    assert tab.evaluate("latest.phase") == "ready"
    tab.tap("Escape")
    assert tab.evaluate("document.activeElement.id") == "stage"
    tab.tap("ArrowUp")
    tab.wait_for("latest.phase === 'playing'")


def test_touch_buttons_steer(tab: Tab) -> None:
    tab.resize(390, 844, mobile=True)
    box = "document.querySelector('[data-control=left]').getBoundingClientRect()"
    x, y = tab.evaluate(f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]")
    touch: dict[str, Any] = {"touchPoints": [{"x": x, "y": y}]}
    tab.call("Input.dispatchTouchEvent", type="touchStart", **touch)
    tab.wait_for("latest.steps > 2 && element('action').textContent === 'left'")
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    tab.wait_for("element('action').textContent === 'none'")
    assert tab.evaluate("document.documentElement.scrollWidth") == 390


def test_a_lost_connection_is_resumed_where_it_was(tab: Tab) -> None:
    tab.tap("ArrowUp")
    tab.wait_for("latest.steps > 2")
    seed = tab.evaluate("latest.seed")
    tab.evaluate("socket.close()")
    tab.wait_for("latest.phase === 'paused'")
    assert tab.evaluate("latest.seed") == seed
    tab.tap("ArrowUp")
    tab.wait_for("latest.phase === 'playing' && latest.steps > 3")


def test_a_frame_that_cannot_be_decoded_is_left_out(tab: Tab) -> None:
    tab.evaluate(
        "globalThis.decode = createImageBitmap; globalThis.createImageBitmap = async () =>"
        " { globalThis.createImageBitmap = decode; throw new Error('no memory'); }"
    )
    tab.tap("ArrowUp")
    tab.wait_for("latest.steps > 8")


def test_everything_on_the_page_to_play_on_has_a_name_and_a_visible_focus(tab: Tab) -> None:
    seen = names_and_focus(tab, "play", 24)
    expected = {"to-play", "to-look", "restart", "task", "variant", "seed", "who", "view", "name"}
    assert expected | {"grip"} <= seen
