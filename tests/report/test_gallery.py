"""The gallery: every registered environment, from the registry."""

import html
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from magical import cli
from magical.envs import EnvId, all_env_ids
from magical.envs.env import MagicalEnv
from magical.errors import SiteError
from magical.evaluation import environments
from magical.experts import rollout
from magical.report.gallery import EnvPreview, check_site, make_previews, write_gallery
from magical.report.gallery.descriptions import (
    describe_changes,
    describe_scene,
    describe_task,
)
from magical.report.gallery.site import gallery_page
from magical.scene import Block, Colour, Pose, Region, Scene, Shape
from magical.tasks import CHANGES, TASKS, Axis, Task, get_task, register_task, unregister_task
from tests.report.html_elements import Elements

pytest.importorskip("jinja2", reason="the report extra is not installed")
pytest.importorskip("matplotlib", reason="the report extra is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small task's gallery."""
    folder = tmp_path_factory.mktemp("gallery") / "site"
    argv = ["gallery", "--task", "MoveToRegion", "--workers", "1", "--out", str(folder)]
    assert cli.main(argv) == 0
    return folder


@pytest.fixture
def outside() -> Iterator[Task]:
    """A task of a user's own, without an expert."""
    task = replace(get_task("MoveToRegion"), name="DriveThere", section="")
    yield register_task(task)
    unregister_task("DriveThere")


def blank(env_id: EnvId) -> EnvPreview:
    return EnvPreview(env_id, "a robot", b"still", b"animation", 0.5)


def test_every_registered_environment_is_on_the_page() -> None:
    text = gallery_page([blank(env_id) for env_id in all_env_ids()])
    page = Elements(text)
    assert page.open == []
    ids = page.values("id")
    assert len(ids) == len(set(ids))
    for env_id in all_env_ids():
        name = f"{env_id.task}-{env_id.variant}"
        assert name in ids
        assert f"<code>{env_id}</code>" in text
        assert f"rollouts/{name}.webp" in page.values("href", "a")
    for task in TASKS.values():
        assert task.summary in html.unescape(text)
        assert f"{task.horizon} control steps" in text
    assert text.count("; in the published code ") == sum(t.has_two_horizons for t in TASKS.values())
    assert {f"#{name}" for name in ids} >= {a for a in page.values("href") if a.startswith("#")}


def test_images_exist_animate_and_have_words(site: Path) -> None:
    page = Elements((site / "index.html").read_text())
    ids = environments(["MoveToRegion"])
    images = [attributes for tag, attributes in page.found if tag == "img"]
    assert len(images) == 2 * len(ids)  # in the overview and in the task's part
    for attributes in images:
        assert attributes["alt"].startswith("MoveToRegion ")
        assert attributes["loading"] == "lazy"
        with Image.open(site / attributes["src"]) as image:
            assert getattr(image, "n_frames", 1) == 1
            assert (str(image.width), str(image.height)) == (
                attributes["width"],
                attributes["height"],
            )
    # Nothing is loaded from elsewhere.
    assert not re.findall(r"https?:|//(?=\w+\.)|url\(|@import", (site / "index.html").read_text())
    for address in [*page.values("src"), *page.values("href")]:
        assert address.startswith("#") or (site / address).is_file()
    rollouts = [address for address in page.values("href", "a") if address.endswith(".webp")]
    assert len(rollouts) == len(ids)
    for address in rollouts:
        with Image.open(site / address) as image:
            assert getattr(image, "n_frames", 1) > 5


def test_scenes_and_scores_are_the_environments_own() -> None:
    env_id = EnvId("MoveToRegion", "TestAll")
    (preview,) = make_previews([env_id], seed=3, workers=1)
    env = MagicalEnv("MoveToRegion", "TestAll", observation="state")
    env.reset(seed=3)
    assert preview.scene == describe_scene(env.state().scene)
    assert preview.score == rollout("MoveToRegion", "TestAll", 3).score


def test_the_images_do_not_depend_on_the_number_of_processes() -> None:
    ids = environments(["MoveToRegion"], ["Demo", "All"])
    assert list(make_previews(ids, 1, workers=2)) == list(make_previews(ids, 1, workers=1))


def test_a_task_of_ones_own_appears(
    outside: Task, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["gallery", "--task", outside.name, "--workers", "1", "--json", "--out", str(tmp_path)]
    assert cli.main(argv) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    ids = environments([outside.name])
    assert report["scores"] == dict.fromkeys(ids)  # no expert, no score
    written = sum(path.stat().st_size for path in tmp_path.rglob("*.*"))
    assert report["bytes"] == written
    text = html.unescape((tmp_path / "index.html").read_text())
    assert text.count("There is no scripted expert.") == len(ids)
    assert "The robot in a region: 1 if its centre is inside one, otherwise 0" in text
    assert not (tmp_path / "rollouts").exists()


def test_a_gallery_is_replaced(site: Path) -> None:
    before = {path: path.read_bytes() for path in site.rglob("*.*")}
    argv = ["gallery", "--task", "MoveToRegion", "--seed", "1", "--workers", "1"]
    assert cli.main([*argv, "--out", str(site)]) == 0
    assert {path: path.read_bytes() for path in site.rglob("*.*")}.keys() == before.keys()
    assert "reset(seed=1)" in (site / "index.html").read_text()


@pytest.mark.parametrize("name", ["notes.txt", "index.html", "scenes/photo.jpg", "rollouts"])
def test_a_folder_with_something_else_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    assert cli.main(["gallery", "--out", str(tmp_path)]) == 1
    assert Path(name).parts[0] in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == [Path(name).name]
    with pytest.raises(SiteError, match="choose another"):
        write_gallery(tmp_path, [])
    assert cli.main(["gallery", "--task", "MoveIt", "--out", str(tmp_path / "new")]) == 2
    assert "MoveIt" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_what_a_killed_gallery_left_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / ".MakeLine-Demo.webp.12.part").touch()
    (tmp_path / ".index.html.12.part").touch()
    check_site(tmp_path)
    with pytest.raises(SiteError, match="found a file"):
        check_site(tmp_path / ".index.html.12.part")


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_every_tasks_docstring_describes_it(task: Task) -> None:
    description = describe_task(task)
    words = " ".join(paragraph.text for paragraph in description.scoring_rule)
    assert len(words) > 60
    assert "Horizon" not in words
    assert "`" not in words
    named = " ".join(description.variation).lower()
    assert all(str(axis.name).lower() in named for axis in CHANGES if axis in task.axes)


def test_other_tasks_are_described_by_their_score_function() -> None:
    def score(factor: float, scene: Scene, poses: object) -> float:
        """How far it got.

        More of it.
        """
        return factor

    task = replace(get_task("MoveToRegion"), name="Mine", score_fn=partial(score, 1.0))
    description = describe_task(task)
    assert [paragraph.text for paragraph in description.scoring_rule] == ["How far it got."]
    assert not description.variation
    formulas = [p.text for p in describe_task(get_task("FindDupe")).scoring_rule if p.is_formula]
    assert formulas == ["[q in R] x [T & R not empty] x (1 - |D & R| / |R|)."]


def test_changes_are_the_variants_axes() -> None:
    assert set(CHANGES) == set(Axis)
    corner = get_task("MoveToCorner")
    assert describe_changes(corner, "Demo") == "the scene of the demonstrations"
    assert describe_changes(corner, "TestShape") == CHANGES[Axis.SHAPE]
    assert describe_changes(corner, "TestAll") == "jitter, colour, shape, dynamics"


def test_a_scene_in_words() -> None:
    squares = [Block(Shape.SQUARE, Colour.RED, Pose(x, 0.0, 0.0)) for x in (-0.5, 0.5)]
    star = Block(Shape.STAR, Colour.GREEN, Pose(0.0, 0.5, 0.0))
    region = Region(Colour.BLUE, x=0.0, y=0.0, height=0.5, width=0.5)
    scene = Scene(Pose(0.0, -0.5, 0.0), (squares[0], star, squares[1]), (region,))
    assert describe_scene(scene) == "a robot, 1 blue goal region, 2 red squares, 1 green star"
