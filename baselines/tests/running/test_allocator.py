"""The C library's allocator during training."""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from magical_baselines.running.allocator import keep_freed_memory

# Prints how many pages the system has to provide while some blocks of 20 MB come and go.
FAULTS = """
import ctypes, resource, sys
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
BEFORE
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
libc.memset.argtypes = (ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t)
for number in range(6):
    blocks = [libc.malloc(20_000_000) for _ in range(4)]
    for block in blocks:
        libc.memset(block, 1, 20_000_000)
    for block in blocks:
        libc.free(block)
    if number == 0:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
CALL = """
from magical_baselines.running.allocator import keep_freed_memory
assert keep_freed_memory()
"""
TRAIN = """
settings = dict(demos=sys.argv[1], num_demos=2, network="light", batches=1, device="cpu")
train(BCConfig.preset("quick", tasks=("MoveToCorner",), **settings), sys.argv[2])
"""


def page_faults(before: str, *arguments: str) -> int:
    command = [sys.executable, "-c", FAULTS.replace("BEFORE", before), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_freed_memory_is_used_again_as_in_training(
    demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    most = page_faults("") / 4
    assert page_faults(CALL) < most
    assert page_faults(TRAIN, str(demos), str(tmp_path / "run")) < most


def test_what_the_user_has_chosen_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLIBC_TUNABLES", "glibc.malloc.top_pad=0")
    assert not keep_freed_memory()


def test_on_other_systems_nothing_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not keep_freed_memory()
