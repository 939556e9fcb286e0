"""The page in headless Chromium: play with keys and touch, record, watch, take over."""

from pathlib import Path
from typing import Any

import pytest

from magical.demos import Actor, Dataset
from magical.demos.trajectory import replay
from magical.envs.keys import Control, controls_of
from magical.experts import EpisodeExpert, expert_for
from magical_play import session
from magical_play.episodes import PlayedEpisode
from play.tests.browser import Tab
from play.tests.serving import TOKEN, RunningServer

KEYS = dict(zip(Control, ("ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", " "), strict=True))


@pytest.fixture(autouse=True)
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let keys and answers arrive in time on a busy machine."""
    monkeypatch.setattr(session, "STEP_TIME", 0.4)
    monkeypatch.setattr(session, "SILENCE_TIME", 60.0)


def open_page(tab: Tab, server: RunningServer) -> None:
    """Open the page; what its module exports is then `page`."""
    tab.call("Page.navigate", url=f"http://{server.host}/?token={TOKEN}")
    tab.wait_for("document.readyState === 'complete'")
    tab.evaluate("import('/main.js').then((found) => { globalThis.page = found })")
    tab.evaluate("globalThis.element = (id) => document.getElementById(id)")
    tab.wait_for("page.latest?.phase === 'ready'")


def text_of(tab: Tab, name: str) -> str:
    return str(tab.evaluate(f"element('{name}').textContent"))


def choose(tab: Tab, field: str, value: object) -> None:
    """Choose an option, when it is there."""
    tab.wait_for(f"[...element('{field}').options].some((one) => one.value === '{value}')")
    tab.evaluate(f"element('{field}').value = '{value}'")
    tab.evaluate(f"element('{field}').dispatchEvent(new Event('change'))")


def start(tab: Tab, seed: int, who: object = "") -> None:
    tab.evaluate(f"element('seed').value = {seed}")
    choose(tab, "who", who)
    tab.evaluate("element('choose').requestSubmit()")
    tab.wait_for(f"page.latest.seed === {seed}")


def play_expert(tab: Tab, server: RunningServer) -> None:
    """Play the episode to its end, pressing the keys that the expert would."""
    episode, held = server.session.episode, set[Control]()
    assert isinstance(episode, PlayedEpisode)
    expert = EpisodeExpert(expert_for(episode.env_id.task, seed=0))
    while tab.evaluate("page.latest.phase") != "ended":
        state = episode.state
        wanted = set(controls_of(expert.act(state)))
        for control in held ^ wanted:
            tab.key(KEYS[control], down=control in wanted)
        held = wanted
        tab.wait_for(f"page.latest.steps > {state.step}")
        expert.note_executed(episode.actions[state.step])
    for control in held:
        tab.key(KEYS[control], down=False)


def test_play_record_watch_and_take_over(
    tab: Tab, server: RunningServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_page(tab, server)
    # Play.
    tab.evaluate("element('name').value = 'Ada'")
    start(tab, 3)
    assert "Seed 3. Press a key" in text_of(tab, "prompt-text")
    play_expert(tab, server)
    assert "score 1.00. Keep this episode?" in text_of(tab, "prompt-text")
    # Record.
    tab.tap("k")
    tab.wait_for("page.latest.kept === 1")
    assert text_of(tab, "connection") == "Recording; 1 kept"
    (stored,) = Dataset.open(tmp_path / "demos")
    assert (stored.seed, stored.score, stored.demonstrator) == (3, 1.0, "Ada")
    assert replay(stored).departure == 0.0
    # Watch a policy, take over from it, hand back.
    monkeypatch.setattr(session, "STEP_TIME", 0.05)
    start(tab, 4, who=0)
    tab.wait_for("page.latest.steps > 2")
    assert text_of(tab, "acting").startswith("expert is acting")
    tab.key("ArrowLeft", down=True)
    tab.wait_for("page.latest.executed.join() === 'left' && !page.latest.policy_acts")
    assert text_of(tab, "acting").startswith("You are acting")
    assert tab.evaluate("document.querySelector('[data-lit]').dataset.control") == "left"
    tab.key("ArrowLeft", down=False)
    tab.tap("h")
    tab.wait_for("page.latest.phase === 'ended'")
    tab.evaluate("element('keep').click()")
    tab.wait_for("page.latest.kept === 2")
    actors = Dataset.open(tmp_path / "demos")[1].actors
    assert actors is not None
    assert set(actors.tolist()) == {Actor.EXPERT, Actor.HUMAN}
    # Watch an episode.
    choose(tab, "episodes", 0)
    tab.wait_for("page.latest.is_recorded && page.latest.phase === 'ended'")
    tab.tap("Escape")
    pictures = set()
    for key, step in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("End", 40)):
        tab.tap(key)
        tab.wait_for(f"page.latest.steps === {step} && page.shown === page.latest.number")
        pictures.add(tab.evaluate("element('frame').toDataURL()"))
    assert len(pictures) == 4
    controls = controls_of(int(stored.actions[-1]))
    assert f"Last action{' + '.join(controls) or 'none'}" in text_of(tab, "facts")
    choose(tab, "view", "both")
    tab.wait_for("element('frame').width === 776")
    assert tab.problems == []


def test_fields_touch_and_lost_connections(tab: Tab, server: RunningServer) -> None:
    open_page(tab, server)
    tab.evaluate("element('name').focus()")
    for key in ("r", " ", "k", "ArrowUp"):
        tab.tap(key)
    assert tab.evaluate("element('name').value") == "r k"
    assert tab.evaluate("page.latest.phase") == "ready"
    tab.tap("Escape")
    assert tab.evaluate("document.activeElement.id") == "stage"
    box = "document.querySelector('[data-control=left]').getBoundingClientRect()"
    x, y = tab.evaluate(f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]")
    touch: dict[str, Any] = {"touchPoints": [{"x": x, "y": y}]}
    tab.call("Input.dispatchTouchEvent", type="touchStart", **touch)
    tab.wait_for("page.latest.steps > 2 && page.latest.executed.join() === 'left'")
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    tab.wait_for("!page.latest.executed.length")
    tab.tap("p")
    tab.wait_for("page.latest.phase === 'paused'")
    steps = tab.evaluate("page.latest.steps")
    tab.evaluate("page.socket.close()")
    tab.wait_for("page.socket.readyState === WebSocket.OPEN && page.latest")
    tab.tap("p")
    tab.wait_for(f"page.latest.phase === 'playing' && page.latest.steps > {steps}")
    tab.evaluate(  # a frame that cannot be decoded is left out
        "globalThis.decode = createImageBitmap; globalThis.createImageBitmap = async () =>"
        " { globalThis.createImageBitmap = decode; throw new Error('no memory'); }"
    )
    tab.tap("r")
    tab.wait_for("page.latest.phase === 'ready'")
    tab.tap("ArrowUp")
    tab.wait_for("page.latest.steps > 2 && page.shown === page.latest.number")


def test_everything_on_the_page_has_a_name_and_a_visible_focus(
    tab: Tab, server: RunningServer
) -> None:
    open_page(tab, server)
    names = tab.evaluate(
        "[...document.querySelectorAll('button, input, select')].map((one) =>"
        " one.getAttribute('aria-label') || one.labels?.[0]?.textContent || one.textContent)"
    )
    assert len(names) > 20
    assert all(name.strip() for name in names)
    seen = set()
    for _ in range(20):
        tab.tap("Tab")
        name, *outline = tab.evaluate(
            "(({ activeElement: one }) => { const style = getComputedStyle(one);"
            " return [one.id || one.dataset.control, style.outlineStyle, style.outlineWidth]"
            " })(document)"
        )
        if tab.evaluate("document.activeElement !== document.body"):
            assert outline == ["solid", "3px"], name
            seen.add(name)
    assert {"grip", "restart", "task", "who", "seed", "dataset", "view", "name"} <= seen
