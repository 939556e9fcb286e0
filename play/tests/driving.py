"""Driving the page in a browser as a person does."""

import json

from magical.envs.keys import Control, controls_of
from magical.experts import expert_for
from magical.experts.rollout import EpisodeExpert
from play.tests.browser import Tab
from play.tests.serving import TOKEN, RunningServer

KEYS = {
    Control.FORWARD: "ArrowUp",
    Control.BACK: "ArrowDown",
    Control.LEFT: "ArrowLeft",
    Control.RIGHT: "ArrowRight",
    Control.GRIP: " ",
}


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


def open_page(tab: Tab, server: RunningServer, page: str = "") -> None:
    """Open a server's page; what its modules export is then global."""
    tab.call("Page.navigate", url=f"http://{server.host}/?token={TOKEN}{page}")
    expose(tab)


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
