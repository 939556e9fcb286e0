"""Malicious pickles: each is refused by name, and nothing in it is executed."""

import copyreg
import gzip
import io
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from magical.demos.human.published import read_demonstration
from magical.demos.human.safe_pickle import PublishedRecord, load
from magical.errors import MagicalError, UnsafeFileError
from tests.demos.conftest import name, text

MARKER = Path("executed")  # in the working folder, which is the test's own
P4 = b"\x80\x04"  # PROTO
RECONSTRUCT = name("numpy.core.multiarray", "_reconstruct")
RECORD = name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
ORDERED_DICT, DTYPE = name("collections", "OrderedDict"), name("numpy", "dtype")
SCRIPT = f"open({str(MARKER)!r}, 'w').close()"


class Calls:
    """Pickles to a call of a function."""

    def __init__(self, function: Any, *arguments: Any, state: Any = None) -> None:
        self.reduced = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self) -> Any:
        return self.reduced


def dumped(function: Any, *arguments: Any, protocol: int = 4) -> bytes:
    return pickle.dumps(Calls(function, *arguments), protocol)


def called(module: str, attribute: str, *arguments: str) -> bytes:
    """STACK_GLOBAL and REDUCE."""
    packed = b"(" + b"".join(map(text, arguments)) + b"t"
    return name(module, attribute) + packed + b"R"


def nested(payload: bytes) -> bytes:
    """A payload where a trajectory's observations should be."""
    return b"\x80\x04}" + text("trajectory") + RECORD + b"(N" + payload + b"]]t\x81s."


def memoised() -> bytes:
    """The names lie in the memo long before STACK_GLOBAL takes them from there."""
    first = P4 + text("os") + b"\x940" + text("system") + b"\x940"
    return first + b"h\x00h\x01\x93" + b"(" + text(f"touch {MARKER}") + b"tR."


def extension() -> bytes:
    """A global by its number in the extension registry."""
    return b"\x80\x02\x82\x07(" + b"X" + np.uint32(len(SCRIPT)).tobytes() + SCRIPT.encode() + b"tR."


def extended() -> bytes:
    """`pickle.loads` finds extension 7 as `builtins.exec`."""
    copyreg.add_extension("builtins", "exec", 7)
    return extension()


OS = "nt" if os.name == "nt" else "posix"
TOUCH = f"touch {MARKER}"
MALICIOUS: dict[str, Callable[[], bytes]] = {
    **{
        f"reduce os.system, protocol {n}": lambda n=n: dumped(os.system, TOUCH, protocol=n)  # type: ignore[misc]
        for n in range(6)
    },
    "builtins.eval": lambda: dumped(eval, SCRIPT),
    "builtins.exec": lambda: dumped(exec, SCRIPT),
    "builtins.exec by its old name": lambda: (
        b"c__builtin__\nexec\n(S" + repr(SCRIPT).encode() + b"\ntR."
    ),
    "getattr chain": lambda: (
        P4
        + name("builtins", "getattr")
        + b"("
        + called("importlib", "import_module", "os")
        + text("system")
        + b"tR("
        + text(TOUCH)
        + b"tR."
    ),
    "dotted name": lambda: P4 + called("os", "path.os.system", TOUCH) + b".",
    "subprocess": lambda: dumped(subprocess.check_call, ["touch", str(MARKER)]),
    "nested in the trajectory": lambda: nested(called(OS, "system", TOUCH)),
    "memoised STACK_GLOBAL": memoised,
    "extension code": extended,
    "INST": lambda: b"(S" + repr(TOUCH).encode() + b"\ni" + OS.encode() + b"\nsystem\n.",
    "OBJ": lambda: b"(c" + OS.encode() + b"\nsystem\nS" + repr(TOUCH).encode() + b"\no.",
    "open for writing": lambda: P4 + called("io", "open", str(MARKER), "w") + b".",
    "numpy saving a file": lambda: (
        P4 + name("numpy", "save") + b"(" + text(str(MARKER)) + b"]K\x01aK\x00tR0N."
    ),
    "runpy": lambda: P4 + called("runpy", "run_path", "evil.py") + b".",
    "state of an object": lambda: pickle.dumps(
        Calls(copyreg._reconstructor, object, object, None, state=Calls(os.system, TOUCH))  # type: ignore[attr-defined]
    ),
}
UNSUPPORTED: dict[str, bytes] = {
    "NEWOBJ_EX": P4
    + name("subprocess", "Popen")
    + b")}"
    + text("args")
    + b"]("
    + text("touch")
    + text(str(MARKER))
    + b"es\x92.",
    "persistent id": P4 + text("x") + b"Q.",
    "persistent id as text": b"Pos.system\n.",
    "numpy loading a file": P4 + called("numpy", "load", "evil.npy") + b".",
    "BUILD on a function": P4 + RECONSTRUCT + b"}" + text("__code__") + b"Nsb.",
    "BUILD on a function by slots": P4 + RECONSTRUCT + b"N}" + text("__code__") + b"Ns\x86b.",
    "BUILD on a class": P4 + ORDERED_DICT + b"}" + text("__setitem__") + b"Nsb.",
    "calling ndarray": P4 + name("numpy", "ndarray") + b"J\xff\xff\xff\x7f\x85R.",
    "reconstructing another class": P4 + RECONSTRUCT + ORDERED_DICT + b"K\x00\x85C\x01b\x87R.",
    "object dtype": P4 + DTYPE + text("O8") + b"K\x00K\x01\x87R.",
    "allowed module, other name": P4 + name("numpy", "fromfile") + b".",
    "the five under another module": P4 + name("numpy._core.multiarray", "_reconstruct") + b".",
    "dotted from an allowed name": P4
    + name("collections", "OrderedDict.__init__.__globals__")
    + b".",
    "a buffer out of band": b"\x80\x05\x97.",
    "a set": b"\x80\x04\x8f.",
    "terminal escapes": P4 + name("os\x1b[2J\x07", "system") + b".",
    "underflow": b"\x80\x04R.",
    "no end": b"\x80\x04]",
    "two values": b"\x80\x04]].",
    "more after the end": b"\x80\x04}.}.",
    "memo of nothing": b"\x80\x04h\x05.",
    "not a pickle": b"PK\x03\x04 hello",
    "empty": b"",
    "a list of itself": b"\x80\x04]\x94h\x00a.",
    "a dict of keys that are not strings": b"\x80\x04}]Ns.",
    "a large item": b"\x80\x04\x8e" + (1 << 62).to_bytes(8, "little") + b"x.",
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(SCRIPT)
    return tmp_path


@pytest.fixture(autouse=True)
def _forget_extension() -> Any:
    yield
    if ("builtins", "exec") in copyreg._extension_registry:  # type: ignore[attr-defined]
        copyreg.remove_extension("builtins", "exec", 7)


@pytest.mark.parametrize("name", MALICIOUS)
def test_malicious_pickle_is_refused_and_not_executed(
    here: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    payload = MALICIOUS[name]()
    record = ModuleType("milbench.baselines.saved_trajectories")
    vars(record)["MILBenchTrajectory"] = PublishedRecord
    for module in ("milbench", "milbench.baselines", record.__name__):
        monkeypatch.setitem(sys.modules, module, record)
    with suppress(pickle.UnpicklingError):
        loaded = pickle.loads(payload)  # noqa: S301  (must execute code to be a test)
        getattr(loaded, "close", lambda: None)()
    monkeypatch.undo()
    monkeypatch.chdir(here)
    assert list(here.glob("executed*")), "harmless payload"
    for trace in here.glob("executed*"):
        trace.unlink()
    refuse(here, payload)


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_unsupported_pickle_is_refused_and_not_executed(here: Path, name: str) -> None:
    refuse(here, UNSUPPORTED[name])


def refuse(here: Path, payload: bytes) -> None:
    file = here / "demo.pkl.gz"
    file.write_bytes(gzip.compress(payload))
    modules = set(sys.modules)
    with pytest.raises(MagicalError) as caught:
        read_demonstration(file)
    assert str(caught.value).startswith(str(file))
    assert str(caught.value).isprintable()
    assert not list(here.glob("executed*"))
    assert not any("milbench" in module for module in set(sys.modules) - modules)


def test_message_names_the_byte_and_the_reason() -> None:
    with pytest.raises(
        UnsafeFileError, match=r"byte 2\d.*expected only numpy .*, found the name os\.system"
    ):
        load(io.BytesIO(P4 + text("a" * 8) + called("os", "system")), lambda a: a)


DEEP = b")" + b"\x85" * 100_000  # a tuple in a tuple in a tuple ...
DOUBLED = b")" + b"".join(b"\x94h" + bytes([i]) + b"\x86" for i in range(100))  # 2^100 elements
UINT8 = DTYPE + text("u1") + b"K\x00K\x01\x87R"
NEW_ARRAY = RECONSTRUCT + name("numpy", "ndarray") + b"K\x00\x85C\x01b\x87R"


def in_every_place(value: bytes) -> Iterator[bytes]:
    """Pickles with a value in every place that is checked."""
    trajectory = text("trajectory") + RECORD + b"(" + value + b"]]]t\x81"
    fields = (trajectory, text("score") + value, text("env_name") + value)
    yield b"\x80\x04}(" + b"".join(fields) + b"u."
    yield b"\x80\x04}(" + trajectory + text("score") + value
    yield P4 + value + b"."
    yield b"\x80\x04}(" + value + b"Nu."
    yield P4 + value + text("system") + b"\x93."
    yield P4 + DTYPE + value + b"K\x00K\x01\x87R."
    yield P4 + RECONSTRUCT + value + b"K\x00K\x01\x87R."
    yield P4 + UINT8 + b"(K\x03" + value + b"NNNtb."
    yield P4 + UINT8 + b"(K\x03" + text("|") + value + b"NNtb."
    yield P4 + NEW_ARRAY + b"(" + value + b")" + UINT8 + b"\x89C\x00tb."
    yield P4 + NEW_ARRAY + b"(K\x01" + value + UINT8 + b"\x89C\x00tb."
    yield P4 + NEW_ARRAY + b"(K\x01" + value + b"\x85" + UINT8 + b"\x89C\x00tb."
    yield P4 + NEW_ARRAY + b"(K\x01)" + value + b"\x89C\x00tb."


def test_nested_and_shared_values_are_refused_at_once(here: Path, published: Any) -> None:
    good = published()
    (here / "in").mkdir()
    for number, payload in enumerate((*in_every_place(DEEP), *in_every_place(DOUBLED))):
        (here / "in" / f"demo-{number:02}.pkl.gz").write_bytes(gzip.compress(payload))
    for number, value in enumerate((DEEP, DOUBLED)):
        made = published()
        made.score = value
        made.write(here / "in" / f"score-{number}.pkl.gz")
    good.write(here / "in" / "good.pkl.gz")
    command = ["demos", "import", "in", "--out", "out", "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "magical", *command],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "imported 1 demonstrations" in done.stdout
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: in/")]
    assert len(lines) == 28
    assert max(map(len, lines)) < 400


def test_shape_that_overflows_is_refused(here: Path) -> None:
    huge = b"\x8a\xfa" + b"\x00" * 249 + b"\x01"  # LONG1
    refuse(here, P4 + NEW_ARRAY + b"(K\x01K\x00" + huge + b"\x86" + UINT8 + b"\x89C\x00tb.")


@pytest.mark.posix
def test_special_files_are_refused(here: Path) -> None:
    os.mkfifo(here / "fifo.pkl.gz")
    (here / "link.pkl.gz").symlink_to("/dev/zero")
    for file in ("fifo", "link"):
        with pytest.raises(UnsafeFileError, match="not a regular file"):
            read_demonstration(here / f"{file}.pkl.gz")


def test_linked_file_is_read(here: Path, published: Any) -> None:
    (here / "link.pkl.gz").symlink_to(published().write(here / "demo"))
    assert len(read_demonstration(here / "link.pkl.gz").actions) == 2
