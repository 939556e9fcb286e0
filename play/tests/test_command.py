"""`magical play`."""

import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
from uvicorn import Server

from magical import cli
from magical.demos import Dataset

ADDRESS = re.compile(r"(http://127\.0\.0\.1:\d+/)\?token=([\w-]{43})\n")


@pytest.mark.posix
def test_the_first_line_is_the_address_with_the_token(tmp_path):
    command = [sys.executable, "-m", "magical", "play", "--port", "0", "--record", "demos"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=tmp_path, **pipes)
    try:
        url, token = ADDRESS.fullmatch(process.stdout.readline()).groups()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{url}elsewhere?token={token}", timeout=60)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out) == (130, "")
    assert errors == "recording into demos\ninterrupted\n"
    assert len(Dataset.open(tmp_path / "demos")) == 0


def test_a_server_that_others_reach_says_what_they_can_read(monkeypatch, capsys):
    monkeypatch.setattr(Server, "run", lambda *_, **__: None)
    for host, is_said in (("127.0.0.1", False), ("0.0.0.0", True)):
        assert cli.main(["play", "--host", host, "--port", "0"]) == 0
        said = capsys.readouterr().err
        for words in ("in the clear", "HTTPS", "--allow-host"):
            assert (words in said) is is_said


def test_what_cannot_be_played_or_watched_is_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        for option, value, status, message in (
            ("--port", port, 1, f"cannot listen on 127.0.0.1, port {port}"),
            ("--record", "file", 1, "file: cannot be written"),
            ("--datasets", "missing", 1, "missing: expected a"),
            ("--runs", "missing", 1, "missing: expected a"),
            ("--env", "magical/MoveToMoon-Demo-v0", 2, "MoveToMoon"),
        ):
            assert cli.main(["play", option, value]) == status
            assert message in capsys.readouterr().err
