"""Looking and watching in headless Chromium, up to a policy trained from what was played."""

import re
from pathlib import Path

import pytest

from magical import cli
from magical.demos import Actor, Dataset, DatasetWriter
from magical.demos.generate import demonstrate
from magical.envs.keys import controls_of
from magical_play.security import RateLimit
from play.tests.browser import Browser, Tab
from play.tests.driving import names_and_focus, open_page, play_expert, text_of
from play.tests.serving import RunningServer, running
from play.tests.test_page import contrast


def look(tab: Tab) -> None:
    """Go to the page to look on."""
    tab.evaluate("element('to-look').click()")
    tab.wait_for("!element('look').hidden && document.querySelector('#episodes li')")


def open_newest(tab: Tab) -> None:
    """Open the first episode of the list."""
    tab.evaluate("document.querySelector('#episodes .open').click()")
    tab.wait_for("panes[0]?.painted")


def choose(tab: Tab, field: str, value: str) -> None:
    """Choose an option, when it is there."""
    tab.wait_for(f"[...element('{field}').options].some((one) => one.value === '{value}')")
    tab.evaluate(f"element('{field}').value = '{value}'")
    tab.evaluate(f"element('{field}').dispatchEvent(new Event('change'))")


def fact(tab: Tab, name: str, pane: int = 0) -> str:
    """One of the facts of the step that is shown."""
    script = (
        f"[...panes[{pane}].root.querySelectorAll('.facts div')]"
        f".find((one) => one.firstChild.textContent === '{name}')?.lastChild.textContent ?? ''"
    )
    return str(tab.evaluate(script))


def picture(tab: Tab, pane: int = 0) -> str:
    return str(tab.evaluate(f"panes[{pane}].part('.picture').toDataURL()"))


def test_everything_on_the_page_to_look_on_has_a_name_and_a_visible_focus(
    tab: Tab, dataset: Path
) -> None:
    DatasetWriter(dataset).append(demonstrate("magical/MoveToRegion-Demo-v0", 1))
    look(tab)
    open_newest(tab)
    seen = names_and_focus(tab, "look", 30)
    expected = "source shown-task open reload policy rollout-task rollout-seed close step first run"
    assert {*expected.split(), "last", "speed", "look-view"} <= seen


def test_an_episode_is_scrubbed_with_keys(tab: Tab, dataset: Path) -> None:
    stored = demonstrate("magical/MoveToRegion-Demo-v0", 1)
    DatasetWriter(dataset).append(stored)
    look(tab)
    open_newest(tab)
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
    choose(tab, "look-view", "ego")
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


def test_a_list_that_is_refused_is_not_said_to_be_empty(
    tab: Tab, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    DatasetWriter(dataset).append(demonstrate("magical/MoveToRegion-Demo-v0", 1))
    look(tab)
    monkeypatch.setattr(RateLimit, "allows", lambda *_: False)
    tab.evaluate("element('more').click()")
    tab.wait_for("!element('more').disabled")
    assert text_of(tab, "look-status").startswith("too many requests")
    assert "No episodes yet" not in text_of(tab, "episodes")
    choose(tab, "shown-task", "MoveToRegion")
    tab.wait_for("!element('episodes').children.length")


CLIPPED = """[...document.querySelectorAll('select')].filter((one) => one.offsetParent
  && [...one.options].some((option) => {
    const pen = document.createElement('canvas').getContext('2d');
    pen.font = getComputedStyle(one).font;
    return pen.measureText(option.text).width > one.clientWidth - 36;  // the arrow's room
  })).map((one) => one.id)"""


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_texts_of_choices_fit_and_the_list_stays_near(
    width: int, height: int, tmp_path: Path, browser: Browser
) -> None:
    folder = tmp_path / "human-demonstrations"
    DatasetWriter(folder).append(demonstrate("magical/ClusterColour-TestDynamics-v0", 1))
    run = tmp_path / "runs" / "bc-augmented"
    run.mkdir(parents=True)
    (run / "config.json").write_text('{"algorithm": "bc", "tasks": ["MoveToRegion"]}')
    served = running(datasets=[folder], runs=[tmp_path / "runs"])
    with served as server, browser.open_tab() as tab:
        tab.resize(width, height, mobile=width < 400)
        open_page(tab, server)
        tab.wait_for("latest?.phase === 'ready'")
        assert tab.evaluate(CLIPPED) == []
        look(tab)
        open_newest(tab)
        assert tab.evaluate(CLIPPED) == []
        box = "element('{}').getBoundingClientRect().{}"
        below = f"{box.format('panes', 'top')} - {box.format('episodes', 'bottom')}"
        assert tab.evaluate(below) < 150


def test_every_probability_can_be_read(tab: Tab) -> None:
    look(tab)
    colours = tab.evaluate(
        "import('/grid.js').then(({ showGrid }) => { const grid = document.createElement('div');"
        " element('viewer').append(grid); const found = [];"
        " for (let part = 0; part <= 100; part += 18) {"
        " showGrid(grid, [...Array(18).keys()].map((i) => Math.min(1, (part + i) / 100)));"
        " for (const cell of grid.querySelectorAll('[data-action]')) {"
        " const { backgroundColor, color } = getComputedStyle(cell);"
        " found.push([backgroundColor, color]) } }"
        " return found })"
    )
    assert len(colours) == 6 * 18
    for background, text in colours:
        assert contrast(rgb(background), rgb(text)) >= 4.5, (background, text)


def rgb(colour: str) -> tuple[int, ...]:
    """The channels of a computed colour, `rgb(...)` of 255 or `color(srgb ...)` of 1."""
    scale = 255 if colour.startswith("color") else 1
    return tuple(round(scale * float(part)) for part in re.findall(r"[\d.]+", colour)[:3])


def test_a_page_that_is_only_looked_on_takes_no_environment(
    server: RunningServer, browser: Browser
) -> None:
    with browser.open_tab() as opened:
        open_page(opened, server, "#look")
        opened.wait_for("document.querySelector('#episodes li')")
        assert len(server.players) == 0
        opened.evaluate("element('to-play').click()")
        opened.wait_for("latest?.phase === 'ready'")
        assert len(server.players) == 1


def test_watching_taking_over_and_handing_back_with_keys(tab: Tab, dataset: Path) -> None:
    choose(tab, "who", "0")
    tab.wait_for("latest.policy === 0 && latest.steps > 2")
    assert text_of(tab, "acting").startswith("expert is acting")
    tab.key("ArrowLeft", down=True)
    tab.wait_for("latest.executed?.join() === 'left'")
    assert text_of(tab, "acting").startswith("You are acting")
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


# From keys to a trained policy


def compare_demonstration_with_rollout(tab: Tab) -> None:
    """Open a demonstration, and a rollout beside it, whose policy then judges both."""
    choose(tab, "judge", "")
    listed = "document.querySelector('[data-episode^={}]')"
    for source, button in (("d0", 0), ("rollouts", 1)):  # the rollout beside the demonstration
        choose(tab, "source", source)
        tab.wait_for(f"{listed.format(source)} !== null")
        tab.evaluate(f"{listed.format(source)}.children[{button}].click()")
        tab.wait_for(f"panes[{button}]?.source === '{source}' && panes[{button}].painted")
    tab.wait_for("panes.every((pane) => pane.probabilities)")  # of the rollout's policy


def test_play_keep_load_scrub_train_and_watch(
    dataset: Path, tmp_path: Path, browser: Browser
) -> None:
    pytest.importorskip("torch")
    runs = tmp_path / "runs"
    runs.mkdir()
    with running(record=dataset, runs=[runs]) as server, browser.open_tab() as tab:
        tab.resize(1280, 800)
        open_page(tab, server)
        tab.wait_for("latest?.phase === 'ready'")
        play_expert(tab, server)
        assert text_of(tab, "score") == "1.00"
        tab.tap("k")
        tab.wait_for("latest.kept === 1")

        (demonstration,) = Dataset.open(dataset)
        assert demonstration.score == 1.0

        look(tab)
        open_newest(tab)
        tab.tap("End")
        assert fact(tab, "Score") == "1.00"

        assert cli.main(["train", "bc", "--out", str(runs / "mine"), *TRAINING, str(dataset)]) == 0

        tab.evaluate("element('reload').click()")
        tab.wait_for("element('policy').options.length === 2")
        tab.evaluate("element('rollout-seed').value = 5")
        choose(tab, "policy", "1")
        tab.evaluate("element('rollout').requestSubmit()")
        tab.wait_for("panes[0]?.source === 'rollouts' && panes[0].probabilities")
        assert tab.evaluate("panes[0].probabilities.length") == 40
        described = "panes[0].part('.grid').getAttribute('aria-label')"
        assert tab.evaluate(described).startswith("Action probabilities: ")

        compare_demonstration_with_rollout(tab)

        tab.evaluate("element('to-play').click()")
        choose(tab, "who", "1")
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
    *("--task", "MoveToRegion", "--preset", "quick", "--network", "light", "--batches", "3"),
    *("--num-demos", "1", "--device", "cpu", "--threads", "1", "--demos"),
)
