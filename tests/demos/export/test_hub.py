"""Pushing to and pulling from the Hub, whose part of the protocol a local server plays."""

import base64
import hashlib
import http.server
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from magical.errors import DatasetError

pytest.importorskip("huggingface_hub", reason="the hub extra is not installed")

from magical.demos.export.hub import pull, push
from tests.demos.conftest import MakeTrajectory, Run

REPO = "someone/demos"
SHA = "0" * 40  # of the only commit


class Hub(http.server.ThreadingHTTPServer):
    """One repository: created, committed to with files inside the commit, and read."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files: dict[str, bytes] = {}
        self.created: list[dict[str, Any]] = []
        self.commits: list[dict[str, Any]] = []
        self.denied = 0  # the status that every request gets instead

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(http.server.BaseHTTPRequestHandler):
    server: Hub
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.server.denied:
            return self.reply(b"{}", self.server.denied)
        if self.path == "/api/repos/create":
            self.server.created.append(json.loads(body))
            return self.reply({"url": f"{self.server.address}/datasets/{REPO}"})
        if self.path == "/api/validate-yaml":
            return self.reply({"errors": [], "warnings": []})
        if self.path == f"/api/datasets/{REPO}/preupload/main":
            names = [{"path": f["path"]} for f in json.loads(body)["files"]]
            regular = {"uploadMode": "regular", "shouldIgnore": False}
            return self.reply({"files": [name | regular for name in names]})
        assert self.path == f"/api/datasets/{REPO}/commit/main"
        for line in map(json.loads, body.splitlines()):
            if line["key"] == "header":
                self.server.commits.append(line["value"])
            elif line["key"] == "deletedFile":
                del self.server.files[line["value"]["path"]]
            else:
                content = base64.b64decode(line["value"]["content"])
                self.server.files[line["value"]["path"]] = content
        return self.reply(
            {
                "success": True,
                "commitOid": SHA,
                "commitUrl": f"{self.server.address}/datasets/{REPO}/commit/{SHA}",
            }
        )

    def do_GET(self) -> None:
        path, files = self.path.partition("?")[0], self.server.files
        if self.server.denied or not (files or self.server.created):
            return self.reply(b"{}", self.server.denied or 404, "RepoNotFound")
        if path.startswith(f"/api/datasets/{REPO}/revision/"):
            siblings = [{"rfilename": name} for name in files]
            return self.reply({"id": REPO, "sha": SHA, "private": False, "siblings": siblings})
        if path.startswith(f"/api/datasets/{REPO}/tree/"):
            return self.reply([tree_entry(name, data) for name, data in files.items()])
        name = path.removeprefix(f"/datasets/{REPO}/resolve/{SHA}/")
        return self.reply(files[name])

    do_HEAD = do_GET

    def reply(self, content: Any, status: int = 200, code: str = "") -> None:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("ETag", f'"{hashlib.sha1(body).hexdigest()}"')
        self.send_header("X-Repo-Commit", SHA)
        if code:
            self.send_header("X-Error-Code", code)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *args: Any) -> None:
        pass


def tree_entry(name: str, data: bytes) -> dict[str, Any]:
    sha = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
    return {"type": "file", "path": name, "size": len(data), "oid": sha}


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    from huggingface_hub import constants, hf_api

    server = Hub()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    template = constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(constants.ENDPOINT, server.address)
    monkeypatch.setenv("HF_TOKEN", "hf_local")
    monkeypatch.setattr(constants, "ENDPOINT", server.address)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(hf_api.api, "endpoint", server.address)
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def dataset(make_trajectory: MakeTrajectory, tmp_path: Path) -> Dataset:
    recorded = {"recorded": "2026-03-01T10:00:00+00:00", "versions": {"pymunk": "7.3.0"}}
    writer = DatasetWriter(tmp_path / "demos")
    for seed in range(2):
        writer.append(make_trajectory(seed=seed, metadata=recorded))
    return Dataset.open(tmp_path / "demos")


def test_a_dataset_comes_back_as_it_was(hub: Hub, dataset: Dataset, tmp_path: Path) -> None:
    push(dataset, REPO, "cc-by-4.0", private=True)
    created = hub.created[0]
    assert created.get("visibility", created.get("private")) in ("private", True)
    assert hub.created[0]["type"] == "dataset"
    assert len(hub.commits) == 1
    hub.files["other.bin"] = b"not of a dataset"
    back = pull(REPO, tmp_path / "back")
    assert back.entries == dataset.entries
    found = sorted(p.relative_to(back.path) for p in back.path.rglob("*") if p.is_file())
    assert found == sorted(p.relative_to(dataset.path) for p in dataset.path.rglob("*.[jn]*"))
    assert [path.name for path in tmp_path.glob(".pull-*")] == []


def test_some_of_a_dataset_replace_another(hub: Hub, dataset: Dataset, tmp_path: Path) -> None:
    push(dataset, REPO, "mit")
    push(Dataset(dataset.path, dataset.entries[1:]), REPO, "mit")
    pulled = pull(REPO, tmp_path / "pulled")
    assert list(pulled.entries) == list(dataset.entries[1:])


def test_the_card_says_what_was_recorded(hub: Hub, dataset: Dataset) -> None:
    push(dataset, REPO, "cc-by-4.0")
    card = hub.files["README.md"].decode()
    assert card.startswith("---\nlicense: cc-by-4.0\n")
    assert "| magical/MoveToCorner-Demo-v0 | 2 | 12-12 |" in card
    assert "| random |" in card
    assert "- Recorded: 2026-03-01\n- Version of pymunk: 7.3.0\n" in card
    assert f"magical demos pull {REPO} --out demos" in card


def test_published_demonstrations_are_refused(
    hub: Hub, make_trajectory: MakeTrajectory, tmp_path: Path
) -> None:
    writer = DatasetWriter(tmp_path / "mixed")
    writer.append(make_trajectory())
    source = {"source": "demo-1.pkl.gz", "source_sha256": "a" * 64}
    writer.append(make_trajectory(seed=1, demonstrator="human", metadata=source))
    with pytest.raises(DatasetError, match=r"1 of 2 .*'demo-1.pkl.gz'.* no licence"):
        push(Dataset.open(tmp_path / "mixed"), REPO, "cc-by-4.0")
    assert not hub.created
    own = {"source": "keyboard"}
    DatasetWriter(tmp_path / "own").append(make_trajectory(metadata=own))
    push(Dataset.open(tmp_path / "own"), REPO, "mit")


def test_what_is_damaged_is_neither_pushed_nor_pulled(
    hub: Hub, dataset: Dataset, tmp_path: Path
) -> None:
    push(dataset, REPO, "cc-by-4.0")
    name = dataset.entries[1].file
    hub.files[name] = hub.files[name][:-1] + b"?"
    with pytest.raises(DatasetError, match="000001"):
        pull(REPO, tmp_path / "back")
    assert not (tmp_path / "back").exists()
    (dataset.path / name).write_bytes(hub.files[name])
    hub.commits.clear()
    with pytest.raises(DatasetError, match="000001"):
        push(dataset, REPO, "cc-by-4.0")
    assert not hub.commits


def test_errors_say_what_to_do(hub: Hub, dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"'someone/demos' on the Hub: 404"):
        pull(REPO, tmp_path / "none")
    with pytest.raises(DatasetError, match="expected OWNER/NAME, found 'a b'"):
        pull("a b", tmp_path / "none")
    with pytest.raises(DatasetError, match="new folder"):
        pull(REPO, tmp_path)
    hub.denied = 401
    with pytest.raises(DatasetError, match=r"log in with `hf auth login`"):
        push(dataset, REPO, "cc-by-4.0")


def test_the_commands(hub: Hub, dataset: Dataset, run: Run, tmp_path: Path) -> None:
    arguments = ["push", str(dataset.path), REPO, "--licence", "mit"]
    assert run(*arguments) == (0, {"repository": f"{hub.address}/datasets/{REPO}", "count": 2})
    out = str(tmp_path / "back")
    assert run("pull", REPO, "--out", out) == (0, {"out": out, "count": 2})
    assert main(["demos", *arguments[:-2]]) == 2  # without a licence
