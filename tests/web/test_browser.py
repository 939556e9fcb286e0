"""The page itself, in headless Chromium: keys, touch, recording, a lost connection."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from magical.demos import Dataset
from magical.demos.replay import replay
from magical.envs.keys import Control, controls_of
from magical.experts import expert_for
from magical.experts.rollout import EpisodeExpert
from tests.web.browser import Browser, Tab, find_browser, start_browser
from tests.web.serving import TOKEN, RunningServer

BROWSER = find_browser()
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")

KEYS = {
    Control.FORWARD: "ArrowUp",
    Control.BACK: "ArrowDown",
    Control.LEFT: "ArrowLeft",
    Control.RIGHT: "ArrowRight",
    Control.GRIP: " ",
}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    assert BROWSER is not None
    with start_browser(BROWSER, tmp_path_factory.mktemp("browser")) as started:
        yield started


@pytest.fixture
def tab(server: RunningServer, browser: Browser) -> Iterator[Tab]:
    """The page, ready to be played."""
    with browser.open_tab() as opened:
        opened.resize(1280, 800)
        opened.call("Page.navigate", url=f"http://{server.host}/?token={TOKEN}")
        opened.wait_for("document.readyState === 'complete' && latest?.phase === 'ready'")
        yield opened


def text_of(tab: Tab, name: str) -> str:
    return str(tab.evaluate(f"document.getElementById('{name}').textContent"))


class Keyboard:
    """Holds the keys of controls, and no others."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self._held: set[Control] = set()

    def hold(self, *controls: Control) -> None:
        for control in self._held - set(controls):
            self._tab.key(KEYS[control], down=False)
        for control in set(controls) - self._held:
            self._tab.key(KEYS[control], down=True)
        self._held = set(controls)


def play_expert(tab: Tab, server: RunningServer) -> None:
    """Play the running episode to its end, pressing the keys that the expert would."""
    (player,) = server.players
    episode, keyboard = player.session.episode, Keyboard(tab)
    expert = EpisodeExpert(expert_for(episode.env_id.task, seed=0))
    while True:
        state = episode.env.state()
        keyboard.hold(*controls_of(expert.act(state)))
        tab.wait_for(f"latest.steps > {state.step} || latest.phase === 'ended'")
        if tab.evaluate("latest.phase") == "ended":
            keyboard.hold()
            return
        expert.note_executed(episode.env.get_state()["actions"][state.step])


def test_an_episode_is_played_with_keys_kept_and_found(
    tab: Tab, server: RunningServer, dataset: Path
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


def test_everything_has_a_name_and_a_visible_focus(tab: Tab) -> None:
    names = tab.evaluate(
        "[...document.querySelectorAll('button, input, select')].map((one) =>"
        " one.getAttribute('aria-label') || one.labels?.[0]?.textContent || one.textContent)"
    )
    assert len(names) > 12
    assert all(name.strip() for name in names), json.dumps(names)
    seen = set()
    for _ in range(20):
        tab.tap("Tab")
        name, style, width = tab.evaluate(
            "(({ activeElement: one }) => { const style = getComputedStyle(one);"
            " return [one.id || one.dataset.control || one.textContent,"
            " style.outlineStyle, parseFloat(style.outlineWidth)]; })(document)"
        )
        if tab.evaluate("document.activeElement !== document.body"):
            assert (style, width) == ("solid", 3), name
            seen.add(name)
    assert {"restart", "task", "variant", "seed", "view", "name", "palette", "grip"} <= seen
