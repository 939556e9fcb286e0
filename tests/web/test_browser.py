"""The page itself, in headless Chromium: keys, touch, recording, looking, watching, faults."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from magical import cli
from magical.demos import Actor, Dataset, DatasetWriter
from magical.demos.generate import demonstrate
from magical.demos.replay import replay
from magical.envs import EnvId
from magical.envs.keys import Control, controls_of
from magical.experts import expert_for
from magical.experts.rollout import EpisodeExpert
from magical.web.library.routes import LibrarySettings
from magical.web.server import PlaySettings
from tests.web.browser import Browser, Tab, find_browser, start_browser
from tests.web.serving import TOKEN, RunningServer, running

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
        expose(opened)
        opened.wait_for("latest?.phase === 'ready'")
        yield opened


def expose(tab: Tab) -> None:
    """Give tests what the page's modules export, under the same names."""
    tab.wait_for("document.readyState === 'complete'")
    for module in ("common", "play", "look"):
        tab.evaluate(
            f"import('/{module}.js').then((found) => {{ for (const name of Object.keys(found))"
            " Object.defineProperty(globalThis, name,"
            " { get: () => found[name], configurable: true }) })"
        )


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


def names_and_focus(tab: Tab, page: str, stops: int) -> set[str]:
    """What Tab reaches on a page of the page; all its fields have names and a visible focus."""
    names = tab.evaluate(
        f"[...document.querySelectorAll('#{page} button, #{page} input, #{page} select')]"
        ".map((one) => one.getAttribute('aria-label') || one.labels?.[0]?.textContent"
        " || one.textContent)"
    )
    assert len(names) > 12
    assert all(name.strip() for name in names), json.dumps(names)
    seen = set()
    for _ in range(stops):
        tab.tap("Tab")
        name, style, width = tab.evaluate(
            "(({ activeElement: one }) => { const style = getComputedStyle(one);"
            " return [one.id || one.dataset.control || one.className || one.textContent,"
            " style.outlineStyle, parseFloat(style.outlineWidth)]; })(document)"
        )
        if tab.evaluate("document.activeElement !== document.body"):
            assert (style, width) == ("solid", 3), name
            seen.add(name)
    return seen


def test_everything_on_the_page_to_play_on_has_a_name_and_a_visible_focus(tab: Tab) -> None:
    seen = names_and_focus(tab, "play", 24)
    expected = {"to-play", "to-look", "restart", "task", "variant", "seed", "who", "view", "name"}
    assert expected | {"palette", "grip"} <= seen


def test_everything_on_the_page_to_look_on_has_a_name_and_a_visible_focus(
    tab: Tab, dataset: Path
) -> None:
    DatasetWriter(dataset).append(demonstrate("magical/MoveToRegion-Demo-v0", 1))
    look(tab)
    tab.evaluate("document.querySelector('#episodes .open').click()")
    tab.wait_for("panes[0]?.painted")
    seen = names_and_focus(tab, "look", 30)
    expected = {"source", "open", "reload", "policy", "rollout-task", "rollout-seed", "close"}
    assert expected | {"step", "first", "run", "last", "speed", "look-view", "palette"} <= seen


# Looking


def look(tab: Tab) -> None:
    """Go to the page to look on."""
    tab.evaluate("element('to-look').click()")
    tab.wait_for("!element('look').hidden && document.querySelector('#episodes li')")


def fact(tab: Tab, name: str, pane: int = 0) -> str:
    """One of the facts of the step that is shown."""
    script = (
        f"[...panes[{pane}].root.querySelectorAll('.facts div')]"
        f".find((one) => one.firstChild.textContent === '{name}')?.lastChild.textContent ?? ''"
    )
    return str(tab.evaluate(script))


def picture(tab: Tab, pane: int = 0) -> str:
    return str(tab.evaluate(f"panes[{pane}].part('.picture').toDataURL()"))


def test_an_episode_is_scrubbed_with_keys(tab: Tab, dataset: Path) -> None:
    stored = demonstrate("magical/MoveToRegion-Demo-v0", 1)
    DatasetWriter(dataset).append(stored)
    look(tab)
    tab.evaluate("document.querySelector('#episodes .open').click()")
    tab.wait_for("panes[0]?.frames.filter(Boolean).length === 41")
    pictures = []
    for key, step in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("End", 40)):
        tab.tap(key)
        tab.wait_for(f"panes[0].painted === panes[0].frames[{step}]")
        assert text_of(tab, "step-number") == f"{step} of 40"
        pictures.append(picture(tab))
    assert len(set(pictures)) == 4
    assert fact(tab, "Score") == "1.00"
    tab.tap("ArrowLeft")
    controls = controls_of(int(stored.actions[39]))
    assert fact(tab, "Action") == (" + ".join(controls) or "none")
    tab.tap("Home")
    tab.evaluate("element('speed').value = 16")
    tab.tap(" ")
    tab.wait_for("panes[0].step === 40 && element('run').textContent === 'Play'")
    both = tab.evaluate("panes[0].part('.picture').width")
    tab.evaluate("element('look-view').value = 'ego'")
    tab.evaluate("element('look-view').dispatchEvent(new Event('change'))")
    tab.wait_for("panes[0].part('.picture').width === 384")
    assert both == 776
    assert tab.browser.problems == []


def test_two_episodes_are_compared_in_step(tab: Tab, dataset: Path) -> None:
    writer = DatasetWriter(dataset)
    writer.append(demonstrate("magical/MoveToRegion-Demo-v0", 1))
    writer.append(demonstrate("magical/MoveToCorner-Demo-v0", 1))
    look(tab)
    lines = "document.querySelectorAll('#episodes li')"
    tab.evaluate(f"{lines}[1].children[0].click()")
    tab.wait_for("panes.length === 1")
    tab.evaluate(f"{lines}[0].children[1].click()")
    tab.wait_for("panes.length === 2 && panes[1].painted")
    longest = tab.evaluate("Number(element('step').max)")
    assert longest > 40
    tab.evaluate("go(30)")
    assert tab.evaluate("panes.map((pane) => pane.step)") == [30, 30]
    tab.tap("End")
    assert tab.evaluate("panes.map((pane) => pane.step)") == [40, longest]
    assert text_of(tab, "look-status").startswith("Second episode: MoveToCorner Demo")
    tab.resize(390, 844, mobile=True)
    assert tab.evaluate("document.documentElement.scrollWidth") == 390
    tab.evaluate("document.querySelector('.close').click()")
    assert tab.evaluate("panes.map((pane) => pane.details.task)") == ["MoveToCorner"]
    assert tab.evaluate("document.activeElement.className") == "close"


def test_a_page_that_is_only_looked_on_takes_no_environment(
    server: RunningServer, browser: Browser
) -> None:
    with browser.open_tab() as opened:
        opened.call("Page.navigate", url=f"http://{server.host}/?token={TOKEN}#look")
        expose(opened)
        opened.wait_for("document.querySelector('#episodes li')")
        assert len(server.players) == 0
        opened.evaluate("element('to-play').click()")
        opened.wait_for("latest?.phase === 'ready'")
        assert len(server.players) == 1


def test_watching_taking_over_and_handing_back_with_keys(tab: Tab, dataset: Path) -> None:
    choose_actor(tab, "0")
    tab.wait_for("latest.policy === 0 && latest.steps > 2")
    assert text_of(tab, "acting").startswith("expert acts")
    tab.key("ArrowLeft", down=True)
    tab.wait_for("latest.executed?.join() === 'left'")
    assert text_of(tab, "acting").startswith("You act")
    tab.key("ArrowLeft", down=False)
    tab.tap("h")
    tab.wait_for("latest.policy_acts")
    tab.wait_for("latest.phase === 'ended'")
    tab.tap("k")
    tab.wait_for("latest.kept === 1")
    (stored,) = Dataset.open(dataset)
    assert stored.actors is not None
    assert set(stored.actors.tolist()) == {Actor.EXPERT, Actor.HUMAN}
    assert tab.browser.problems == []


def choose_actor(tab: Tab, number: str) -> None:
    tab.wait_for(f"[...element('who').options].some((one) => one.value === '{number}')")
    tab.evaluate(f"element('who').value = '{number}'")
    tab.evaluate("element('who').dispatchEvent(new Event('change'))")


# From keys to a trained policy


def test_play_keep_load_scrub_train_and_watch(
    dataset: Path, tmp_path: Path, browser: Browser
) -> None:
    pytest.importorskip("torch")
    runs = tmp_path / "runs"
    runs.mkdir()
    library = LibrarySettings(runs=(runs,))
    settings = PlaySettings(EnvId("MoveToRegion", "Demo"), record=dataset, library=library)
    with running(settings) as server, browser.open_tab() as tab:
        tab.resize(1280, 800)
        tab.call("Page.navigate", url=f"http://{server.host}/?token={TOKEN}")
        expose(tab)
        tab.wait_for("latest?.phase === 'ready'")
        play_expert(tab, server)
        assert text_of(tab, "score") == "1.00"
        tab.tap("k")
        tab.wait_for("latest.kept === 1")

        (demonstration,) = Dataset.open(dataset)
        assert demonstration.score == 1.0

        look(tab)
        tab.evaluate("document.querySelector('#episodes .open').click()")
        tab.wait_for("panes[0]?.painted")
        tab.tap("End")
        assert fact(tab, "Score") == "1.00"

        assert cli.main(["train", "bc", "--out", str(runs / "mine"), *TRAINING, str(dataset)]) == 0

        tab.evaluate("element('reload').click()")
        tab.wait_for("element('policy').options.length === 2")
        tab.evaluate("element('policy').value = 1; element('rollout-seed').value = 5")
        tab.evaluate("element('policy').dispatchEvent(new Event('change'))")
        tab.evaluate("element('rollout').requestSubmit()")
        tab.wait_for("panes[0]?.source === 'rollouts' && panes[0].probabilities")
        assert tab.evaluate("panes[0].probabilities.length") == 40
        described = "panes[0].part('.grid').getAttribute('aria-label')"
        assert tab.evaluate(described).startswith("Action probabilities: ")

        tab.evaluate("element('to-play').click()")
        choose_actor(tab, "1")
        tab.wait_for("latest.policy === 1 && latest.steps > 2 && latest.probabilities?.length")
        tab.tap("ArrowLeft")
        tab.wait_for("latest.phase === 'ended' && latest.can_keep")
        tab.tap("k")
        tab.wait_for("latest.kept === 2")
        assert tab.browser.problems == []
    watched = Dataset.open(dataset)[1]
    assert watched.metadata["policy"] == "mine"
    assert 0 < watched.is_demonstrated.sum() < len(watched)


TRAINING = (
    *("--task", "MoveToRegion", "--preset", "quick", "--network", "small", "--batches", "3"),
    *("--num-demos", "1", "--device", "cpu", "--threads", "1", "--demos"),
)
