"""The page in headless Chromium: play with keys and touch, record, watch, take over."""

import re

import pytest

from magical.demos import Actor, Dataset
from magical.envs.keys import controls_of
from magical_play import session
from magical_play.server import PAGE
from play.tests.serving import TOKEN


@pytest.fixture
def page(tab, server, monkeypatch):
    """The tab with the page; what its module exports is then `page` in scripts."""
    monkeypatch.setattr(session, "STEP_TIME", 0.4)  # keys arrive in time on a busy machine
    monkeypatch.setattr(session, "SILENCE_TIME", 60.0)
    tab.call("Page.navigate", url=f"{server.origin}/?token={TOKEN}")
    tab.wait_for("document.readyState === 'complete'")
    tab.evaluate("import('/main.js').then((found) => { globalThis.page = found })")
    tab.evaluate("globalThis.element = (id) => document.getElementById(id)")
    tab.wait_for("page.latest?.phase === 'ready'")
    return tab


def text_of(tab, name):
    return str(tab.evaluate(f"element('{name}').textContent"))


def choose(tab, field, value):
    """Choose an option, when it is there."""
    tab.wait_for(f"[...element('{field}').options].some((one) => one.value === '{value}')")
    tab.evaluate(f"element('{field}').value = '{value}'")
    tab.evaluate(f"element('{field}').dispatchEvent(new Event('change'))")


def start(tab, seed, who=""):
    tab.evaluate(f"element('seed').value = {seed}")
    choose(tab, "who", who)
    tab.evaluate("element('choose').requestSubmit()")
    tab.wait_for(f"page.latest.seed === {seed}")


def test_play_record_watch_and_take_over(page, tmp_path, monkeypatch):
    # Play.
    page.evaluate("element('name').value = 'Ada'")
    start(page, 3)
    assert "Seed 3. Press a key" in text_of(page, "prompt-text")
    page.key("ArrowUp", down=True)
    page.wait_for("page.latest.executed.join() === 'forward'")
    monkeypatch.setattr(session, "STEP_TIME", 0.05)
    page.wait_for("page.latest.phase === 'ended'")
    page.key("ArrowUp", down=False)
    assert "Keep this episode?" in text_of(page, "prompt-text")
    # Record.
    page.tap("k")
    page.wait_for("page.latest.kept === 1")
    assert text_of(page, "connection") == "Recording; 1 kept"
    (stored,) = Dataset.open(tmp_path / "demos")
    assert (stored.seed, stored.demonstrator) == (3, "Ada")
    # Watch a policy, take over from it, hand back.
    start(page, 4, who=0)
    page.wait_for("page.latest.steps > 2")
    assert text_of(page, "acting").startswith("expert is acting")
    page.key("ArrowLeft", down=True)
    page.wait_for("page.latest.executed.join() === 'left' && !page.latest.policy_acts")
    assert text_of(page, "acting").startswith("You are acting")
    page.key("ArrowLeft", down=False)
    page.tap("h")
    page.wait_for("page.latest.phase === 'ended'")
    page.evaluate("element('keep').click()")
    page.wait_for("page.latest.kept === 2")
    actors = Dataset.open(tmp_path / "demos")[1].actors
    assert set(actors.tolist()) == {Actor.EXPERT, Actor.HUMAN}
    # Watch an episode.
    choose(page, "episodes", 0)
    page.wait_for("page.latest.is_recorded && page.latest.phase === 'ended'")
    page.tap("Escape")
    pictures = set()
    for key, step in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("End", 40)):
        page.tap(key)
        page.wait_for(f"page.latest.steps === {step} && page.shown === page.latest.number")
        pictures.add(page.evaluate("element('frame').toDataURL()"))
    assert len(pictures) == 4
    controls = controls_of(int(stored.actions[-1]))
    assert f"Last action{' + '.join(controls) or 'none'}" in text_of(page, "facts")
    choose(page, "view", "both")
    page.wait_for("element('frame').width === 776")
    assert page.problems == []


def test_fields_touch_and_lost_connections(page):
    page.evaluate("element('name').focus()")
    page.tap("r", " ", "k", "ArrowUp")
    assert page.evaluate("element('name').value") == "r k"
    assert page.evaluate("page.latest.phase") == "ready"
    page.tap("Escape")
    box = "document.querySelector('[data-control=left]').getBoundingClientRect()"
    x, y = page.evaluate(f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]")
    touch = {"touchPoints": [{"x": x, "y": y}]}
    page.call("Input.dispatchTouchEvent", type="touchStart", **touch)
    page.wait_for("page.latest.steps > 2 && page.latest.executed.join() === 'left'")
    page.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    page.wait_for("!page.latest.executed.length")
    page.tap("p")
    page.wait_for("page.latest.phase === 'paused'")
    steps = page.evaluate("page.latest.steps")
    page.evaluate("page.socket.close()")
    page.wait_for("page.socket.readyState === WebSocket.OPEN && page.latest")
    page.tap("p")
    page.wait_for(f"page.latest.phase === 'playing' && page.latest.steps > {steps}")


def test_the_page_loads_nothing_from_elsewhere():
    for path in PAGE.iterdir():
        text = path.read_text()
        assert re.findall(r"(?:https?:)?//[\w.]+\.\w+", text) == []
        assert not re.search(r"innerHTML|eval\(|<script>|\son\w+=\"", text)
