"""Datasets and runs to look at: what is listed, episodes step by step, what is refused."""

import asyncio
import json
import struct
import threading
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from magical.demos import Dataset, DatasetWriter, Frames, Trajectory
from magical.demos.generate import demonstrate
from magical.errors import MessageError
from magical.scene import Poses
from magical.tasks import TASKS
from magical.web.library import routes
from magical.web.library.routes import MAX_WAITING_ROLLOUTS, AsciiJSON
from magical.web.library.sources import MAX_ROLLOUTS, RolloutSource, unique_names
from magical.web.security import RateLimit
from tests.web.serving import TOKEN, RunningServer, running

REGION = "magical/MoveToRegion-Demo-v0"


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations with poses; and the first with nothing but its recorded frames."""
    folder = tmp_path_factory.mktemp("library") / "demos"
    writer = DatasetWriter(folder)
    for seed in (1, 2):
        writer.append(demonstrate(REGION, seed, perturb=0.2))
    writer.append(frames_only(Dataset.open(folder)[0]))
    return folder


def frames_only(episode: Trajectory) -> Trajectory:
    times = range(len(episode) + 1)
    return Trajectory(
        env_id=episode.env_id,
        scene=episode.scene,
        actions=episode.actions,
        published_code_score=1.0,
        frames={view: Frames(episode, view).take(times) for view in ("allo", "ego")},
        demonstrator="human",
    )


@pytest.fixture(scope="module")
def library(demos: Path) -> Iterator[RunningServer]:
    with running(datasets=[demos]) as started:
        yield started


def get(server: RunningServer, path: str) -> Any:
    answer = server.get(path)
    assert answer.status == 200, answer.body
    return json.loads(answer.body)


def post(server: RunningServer, content: bytes | dict[str, Any]) -> tuple[int, Any]:
    sent = content if isinstance(content, bytes) else json.dumps(content).encode()
    origin = f"http://{server.host}"
    answer = server.get("/api/rollouts", "POST", content=sent, Origin=origin)
    return answer.status, json.loads(answer.body)


def image_sizes(content: bytes) -> list[tuple[int, int]]:
    sizes = []
    while content:
        (length,) = struct.unpack_from(">I", content)
        sizes.append(Image.open(BytesIO(content[4 : 4 + length])).size)
        content = content[4 + length :]
    return sizes


# What is listed


def test_sources_policies_and_actions_are_listed(library: RunningServer) -> None:
    found = get(library, "/api/library")
    assert [task["name"] for task in found["tasks"]] == list(TASKS)
    assert found["tasks"][0]["env_ids"]["Demo"] == "magical/MoveToCorner-Demo-v0"
    assert found["sources"] == [
        {"key": "d0", "name": "demos"},
        {"key": "rollouts", "name": "Rollouts of policies"},
    ]
    (expert,) = found["policies"]
    assert (expert["number"], expert["name"], expert["algorithm"]) == (0, "expert", None)
    assert set(expert["tasks"]) == set(TASKS)
    assert found["actions"][1] == {"name": "forward-straight-open", "controls": ["forward"]}
    assert found["actors"] == ["policy", "expert", "human"]


def test_the_recorded_dataset_is_always_listed_and_grows(
    server: RunningServer, dataset: Path
) -> None:
    assert get(server, "/api/library")["sources"][0] == {"key": "d0", "name": "demos"}
    listed = "/api/episodes?source=d0&task=&skip=0"
    assert get(server, listed) == {"total": 0, "episodes": []}
    DatasetWriter(dataset).append(demonstrate(REGION, 7))
    assert [entry["seed"] for entry in get(server, listed)["episodes"]] == [7]


def test_episodes_are_listed_newest_first_page_by_page(
    library: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "PAGE_LENGTH", 2)
    first = get(library, "/api/episodes?source=d0&task=&skip=0")
    assert first["total"] == 3
    assert [entry["number"] for entry in first["episodes"]] == [2, 1]
    human, expert = first["episodes"]
    assert (human["demonstrator"], human["score"]) == ("human", None)
    assert (expert["env_id"], expert["seed"]) == (REGION, 2)
    of_task = "/api/episodes?source=d0&task={}&skip=0"
    assert get(library, of_task.format("MoveToRegion"))["total"] == 3
    assert get(library, of_task.format("FindDupe")) == {"total": 0, "episodes": []}
    (last,) = get(library, "/api/episodes?source=d0&task=&skip=2")["episodes"]
    assert last["number"] == 0


# Episodes


def test_an_episode_has_actions_and_the_score_of_every_state(
    library: RunningServer, demos: Path
) -> None:
    shown = get(library, "/api/episode?source=d0&episode=1")
    stored = Dataset.open(demos)[1]
    assert stored.poses is not None
    assert shown["actions"] == stored.actions.tolist()
    assert shown["expert_actions"] == stored.labels.tolist() != shown["actions"]
    scores = [stored.task.score(stored.scene, Poses(bodies)) for bodies in stored.poses]
    assert shown["scores"] == pytest.approx(scores, abs=1e-4)
    assert len(shown["scores"]) == shown["steps"] + 1
    assert shown["views"] == ["allo", "ego", "both"]


def test_frames_are_rendered_where_poses_are_known(library: RunningServer) -> None:
    path = "/api/frames?source=d0&episode=1&view={}&first={}&count={}"
    assert image_sizes(library.get(path.format("both", 0, 3)).body) == [(776, 384)] * 3
    assert image_sizes(library.get(path.format("ego", 39, 16)).body) == [(384, 384)] * 2
    first, second = (library.get(path.format("allo", time, 1)).body for time in (0, 30))
    assert first != second


def test_without_poses_the_stored_frames_are_shown_and_no_scores(
    library: RunningServer, demos: Path
) -> None:
    shown = get(library, "/api/episode?source=d0&episode=2")
    assert (shown["has_poses"], shown["scores"], shown["score"]) == (False, None, None)
    path = "/api/frames?source=d0&episode=2&view={}&first=5&count=1"
    frames = Dataset.open(demos)[2].frames
    assert frames is not None
    sent = Image.open(BytesIO(library.get(path.format("ego")).body[4:]))
    np.testing.assert_array_equal(np.array(sent), frames["ego"][5])
    path = "/api/frames?source=d0&episode=2&view={}&first=40&count=16"
    assert image_sizes(library.get(path.format("both")).body) == [(194, 96)]
    assert image_sizes(library.get(path.format("allo")).body) == [(96, 96)]


# Rollouts


def test_the_expert_is_rolled_out(library: RunningServer) -> None:
    status, made = post(library, {"policy": 0, "env_id": REGION, "seed": 4})
    assert (status, made["source"]) == (200, "rollouts")
    shown = get(library, f"/api/episode?source=rollouts&episode={made['episode']}")
    assert (shown["seed"], shown["demonstrator"], shown["scores"][-1]) == (4, "expert", 1.0)
    listed = get(library, "/api/episodes?source=rollouts&task=&skip=0")["episodes"]
    assert listed[0]["number"] == made["episode"]


def test_old_rollouts_are_dropped_and_folders_of_one_name_told_apart() -> None:
    source = RolloutSource()
    episode = demonstrate(REGION, 1)
    assert [source.add(episode) for _ in range(MAX_ROLLOUTS + 1)] == [*range(MAX_ROLLOUTS + 1)]
    assert list(source.episodes()) == [*range(1, MAX_ROLLOUTS + 1)]
    folders = [Path("a/demos"), Path("b/demos"), Path("c/demos"), Path("other")]
    assert unique_names(folders) == ["demos", "demos (2)", "demos (3)", "other"]


def test_names_of_any_characters_are_sent() -> None:
    assert json.loads(bytes(AsciiJSON({"demonstrator": "\ud800"}).body)) == {
        "demonstrator": "\ud800"
    }


def test_work_is_not_piled_up(library: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    release = threading.Event()
    episode = demonstrate(REGION, 1)

    def slow(*_: Any) -> Any:
        assert release.wait(60)
        return episode

    monkeypatch.setattr(routes, "roll_out", slow)
    answers: list[int] = []
    wanted = {"policy": 0, "env_id": REGION, "seed": 1}
    threads = [
        threading.Thread(target=lambda: answers.append(post(library, wanted)[0]))
        for _ in range(MAX_WAITING_ROLLOUTS + 3)
    ]
    for thread in threads:
        thread.start()
    while len(answers) < 3:  # refused at once
        assert (
            get(library, "/api/episodes?source=d0&task=&skip=0")["total"] == 3
        )  # the rest goes on
    release.set()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [200] * MAX_WAITING_ROLLOUTS + [503] * 3


# What is refused


PATHS = (
    "/api/library",
    "/api/episodes?source=d0&task=&skip=0",
    "/api/episode?source=d0&episode=0",
    "/api/frames?source=d0&episode=0&view=allo&first=0&count=1",
    "/api/probabilities?source=d0&episode=0&policy=1",
)


@pytest.mark.parametrize("path", ["/", *PATHS, "/api/rollouts"])
def test_every_route_needs_token_host_and_origin(library: RunningServer, path: str) -> None:
    method = "POST" if path == "/api/rollouts" else "GET"
    origin = f"http://{library.host}"
    for token in (None, "wrong", TOKEN[:-1]) if path != "/" else ():
        assert library.get(path, method, token=token, Origin=origin).status == 403
    assert library.get(path, method, Host="evil.example", Origin=origin).status == 403
    assert library.get(path, method, Origin="http://evil.example").status == 403
    assert library.get(path, "POST").status == 403
    if method == "GET":
        assert library.get(path, "POST", Origin=origin).status == 405


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/library?more=1", 400),
        ("/api/episodes?source=d0&skip=0", 400),
        ("/api/episodes?source=d0&task=MoveToMoon&skip=0", 400),
        ("/api/episodes?source=d0&task=&skip=-1", 400),
        ("/api/episodes?source=d0&task=&skip=0&skip=1", 400),
        ("/api/episodes?source=../demos&task=&skip=0", 404),
        ("/api/episodes?source=d1&task=&skip=0", 404),
        (f"/api/episodes?source={'d' * 21}&task=&skip=0", 400),
        ("/api/episode?source=d0&episode=3", 404),
        ("/api/episode?source=d0&episode=../0", 400),
        ("/api/episode?source=d0&episode=1e1", 400),
        ("/api/episode?source=d0&episode=%C2%B2", 400),
        ("/api/episode?source=d0&episode=%00%ED%A0%80%0D%0A", 400),
        ("/api/episode?source=d0&episode=" + "9" * 30, 400),
        ("/api/episode?source=d0&episode=" + "%5B" * 900, 400),
        ("/api/episode?source=rollouts&episode=99", 404),
        ("/api/frames?source=d0&episode=0&view=side&first=0&count=1", 400),
        ("/api/frames?source=d0&episode=0&view=allo&first=41&count=1", 404),
        ("/api/frames?source=d0&episode=0&view=allo&first=0&count=17", 400),
        ("/api/frames?source=d0&episode=0&view=allo&first=0&count=0", 400),
        ("/api/probabilities?source=d0&episode=0&policy=7", 404),
        ("/api/probabilities?source=d0&episode=0&policy=0", 422),
    ],
)
def test_other_queries_are_refused_and_say_why(
    library: RunningServer, path: str, status: int
) -> None:
    answer = library.get(path)
    problem = json.loads(answer.body)["problem"]
    assert (answer.status, 0 < len(problem) < 1000) == (status, True)


@pytest.mark.parametrize(
    ("content", "status"),
    [
        (b"", 400),
        (b"[]", 400),
        (b"{" * 500, 400),
        (b" " * 5000, 400),
        (b'{"policy": 0, "env_id": "\\ud800\\u0000", "seed": null}', 400),
        ({"policy": 0, "env_id": REGION}, 400),
        ({"policy": "0", "env_id": REGION, "seed": 1}, 400),
        ({"policy": 0, "env_id": "magical/MoveToMoon-Demo-v0", "seed": 1}, 400),
        ({"policy": 0, "env_id": REGION, "seed": 10**9}, 400),
        ({"policy": 9, "env_id": REGION, "seed": 1}, 404),
    ],
)
def test_other_rollouts_are_refused(
    library: RunningServer, content: bytes | dict[str, Any], status: int
) -> None:
    assert post(library, content)[0] == status


def test_a_body_is_read_no_further_than_is_allowed() -> None:
    class Endless:
        parts = 0

        async def stream(self) -> Any:
            while True:
                self.parts += 1
                yield b" " * 600

    request: Any = Endless()
    with pytest.raises(MessageError, match="at most 1024 bytes"):
        asyncio.run(routes.body(request))
    assert request.parts == 2


def test_requests_are_limited_in_rate(
    library: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RateLimit, "allows", lambda *_: False)
    assert library.get("/api/library").status == 429


def test_a_damaged_dataset_says_so(server: RunningServer, dataset: Path) -> None:
    DatasetWriter(dataset).append(demonstrate(REGION, 7))
    file = dataset / "000000.npz"
    file.write_bytes(file.read_bytes()[:-10])
    answer = server.get("/api/episode?source=d0&episode=0")
    assert answer.status == 422
    assert "expected a trajectory" in json.loads(answer.body)["problem"]


def test_a_hostile_episode_is_an_error_for_who_opens_it_alone(
    server: RunningServer, dataset: Path
) -> None:
    DatasetWriter(dataset).append(demonstrate("magical/MoveToCorner-Demo-v0", 1))
    file = dataset / "000000.npz"
    arrays = dict(np.load(file))
    header = json.loads(arrays["header"].tobytes())
    header["scene"]["blocks"][0][2] = 1e308
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez_compressed(file, allow_pickle=False, **arrays)
    with server.player() as player:
        player.hold("forward")
        for path in ("episode?", "frames?view=both&first=0&count=16&"):
            answer = server.get(f"/api/{path}source=d0&episode=0")
            assert (answer.status, bool(json.loads(answer.body)["problem"])) == (422, True)
        player.wait_for(lambda status: status["steps"] == 2)
