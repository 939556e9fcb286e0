"""Reading published pickles without executing anything.

A pickle is a program for a small stack machine whose opcodes may import and call anything. The
machine here implements only the opcodes that build plain data. The five global names in the
published files are represented by tokens: "calling" one checks its arguments and builds a value of
this module; any other name is refused. Nothing named in a pickle is looked up, imported or called.

The values that the machine builds may be nested or share parts without limit, so they are never
hashed, compared or printed before their type is checked.
"""

import math
import pickletools
from collections.abc import Callable
from gzip import GzipFile
from typing import IO, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from magical.errors import UnsafeFileError
from magical.messages import printable, quoted

# Bounds far above what the largest published file needs: 17,500 opcodes, items of 442,368 bytes,
# and almost no bytes that do not become part of an array at once.
MAX_UNPACKED = 512 << 20  # bytes; the largest published file unpacks to 213 MB
MAX_OPCODES = 200_000
MAX_ITEM = 1 << 20  # bytes of one string, array or line
MAX_HELD = 16 << 20  # bytes of strings and byte strings in memory at any time
MAX_KEPT = 64 << 20  # bytes of arrays after `reduce`
MAX_SIZE = 1 << 31  # of one dimension of an array

Reduce = Callable[[NDArray[Any]], NDArray[Any]]


class Name(NamedTuple):
    """A token for a global name in a pickle."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


DTYPE = Name("numpy", "dtype")
NDARRAY = Name("numpy", "ndarray")
RECONSTRUCT = Name("numpy.core.multiarray", "_reconstruct")
ORDERED_DICT = Name("collections", "OrderedDict")
RECORD = Name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
ALLOWED = {name: name for name in (DTYPE, NDARRAY, RECONSTRUCT, ORDERED_DICT, RECORD)}
BYTE_ORDERS = {"u1": "|", "i8": "<", "f8": "<", "f4": "<"}  # by data type code


class PublishedRecord(NamedTuple):
    """The named tuple of the published files."""

    acts: Any
    obs: Any
    rews: Any
    infos: Any


class Array:
    """An array; `values` is `None` until its state is set."""

    values: NDArray[Any] | None = None


class _Reader:
    """The file that pickletools reads from, with limits on its size and on the size of an item."""

    def __init__(self, file: IO[bytes] | GzipFile) -> None:
        self._file = file
        self._position = 0  # counted here: `GzipFile.tell` is slow

    def read(self, size: int) -> bytes:
        if size > MAX_ITEM:
            raise ValueError(f"an item of {size} bytes, more than {MAX_ITEM}")
        return self._bounded(self._file.read(size))

    def readline(self) -> bytes:
        return self._bounded(self._file.readline(MAX_ITEM))

    def tell(self) -> int:
        return self._position

    def _bounded(self, data: bytes) -> bytes:
        self._position += len(data)
        if self._position > MAX_UNPACKED:
            raise ValueError(
                f"unpacks to more than {MAX_UNPACKED} bytes, more than any published demonstration"
            )
        return data


def load(file: IO[bytes] | GzipFile, reduce: Reduce) -> Any:
    """Load the data of a pickle: plain values, `Array` and `PublishedRecord`.

    `reduce` is applied to every array as it is read, so that large ones need not be kept.

    Raises:
        UnsafeFileError: the pickle contains anything else, exceeds a limit, or is damaged.
    """
    machine, reader = _Machine(reduce), _Reader(file)
    doing = "damaged"
    try:
        for count, (opcode, argument, _) in enumerate(
            pickletools.genops(cast("IO[bytes]", reader))
        ):
            if count > MAX_OPCODES:
                raise ValueError(f"more than {MAX_OPCODES} opcodes")
            doing = opcode.name
            machine.do(opcode.name, argument)
            doing = "damaged"
        if reader.read(1):
            raise ValueError("data after the end")
        return machine.result()
    except (IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        what = printable(f"{doing}: {error}")
        raise UnsafeFileError(
            f"refused at byte {reader.tell()}: {what}; nothing was executed"
        ) from error


class _Machine:
    """The stack machine: its stack, the marks on it, and its memo."""

    def __init__(self, reduce: Reduce) -> None:
        self._reduce = reduce
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        self._held = 0
        self._kept = 0

    def do(self, opcode: str, argument: Any) -> None:
        """Execute one opcode; raises ValueError for one that is not implemented."""
        if opcode not in _ACTIONS:
            raise ValueError("not an opcode of plain data")
        _ACTIONS[opcode](self, argument)

    def result(self) -> Any:
        """The single value that is left on the stack."""
        if len(self._stack) != 1 or self._marks:
            raise ValueError(f"{len(self._stack)} values left, expected 1")
        return self._stack[0]

    def _push(self, argument: Any) -> None:
        if isinstance(argument, str | bytes):
            self._held += len(argument)
            if self._held > MAX_HELD:
                raise ValueError(f"more than {MAX_HELD} bytes that are not part of an array")
        # A bytearray is emptied when it becomes part of an array.
        self._stack.append(bytearray(argument) if isinstance(argument, bytes) else argument)

    def _get(self, index: int) -> None:
        self._stack.append(self._memo[index])

    def _put(self, index: int) -> None:
        self._memo[index] = self._stack[-1]

    def _pop_mark(self) -> list[Any]:
        start = self._marks.pop()
        items = self._stack[start:]
        del self._stack[start:]
        return items

    def _pop(self, kind: type) -> Any:
        (value,) = self._pop_last(1)
        if type(value) is not kind:
            raise ValueError(f"expected {kind.__name__}, found {type(value).__name__}")
        return value

    def _pop_last(self, count: int) -> tuple[Any, ...]:
        if len(self._stack) - (self._marks[-1] if self._marks else 0) < count:
            raise ValueError("the stack is empty")
        items = tuple(self._stack[-count:])
        del self._stack[-count:]
        return items

    def _append(self, items: list[Any]) -> None:
        target = self._stack[-1]
        if type(target) is not list:
            raise ValueError(f"appending to {type(target).__name__}")
        target.extend(items)

    def _set(self, items: list[Any]) -> None:
        target = self._stack[-1]
        keys, values = items[::2], items[1::2]
        if type(target) is not dict or not all(type(key) is str for key in keys):
            raise ValueError(
                f"setting items of {type(target).__name__}, or keys that are not strings"
            )
        target.update(zip(keys, values, strict=True))

    def _global(self, module: str, name: str) -> None:
        if (module, name) not in ALLOWED:
            found = printable(f"{module}.{name}", 60)
            raise ValueError(
                f"expected only numpy arrays and {RECORD.name}, found the name {found}"
            )
        self._stack.append(ALLOWED[Name(module, name)])

    def _stack_global(self, _: Any) -> None:
        name, module = self._pop(str), self._pop(str)
        self._global(module, name)

    def _call(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        first = arguments[0] if len(arguments) == 3 else None
        if name == ORDERED_DICT and not arguments:
            self._stack.append({})
        elif name == DTYPE and type(first) is str and first in BYTE_ORDERS:
            self._stack.append(np.dtype(BYTE_ORDERS[first] + first))
        elif name == RECONSTRUCT and first is NDARRAY:
            self._stack.append(Array())
        else:
            raise ValueError(f"calling {name} with {len(arguments)} unexpected arguments")

    def _new(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        if name != RECORD or len(arguments) != len(PublishedRecord._fields):
            raise ValueError(f"constructing {name} from {len(arguments)} arguments")
        self._stack.append(PublishedRecord(*arguments))

    def _build(self, _: Any) -> None:
        state, target = self._pop(tuple), self._stack[-1]
        if type(target) is Array and target.values is None and len(state) == 5:
            target.values = self._reduce(self._array(*state))
            self._kept += target.values.nbytes
            if self._kept > MAX_KEPT:
                raise ValueError(f"arrays of more than {MAX_KEPT} bytes")
        elif not isinstance(target, np.dtype) or not _is_plain(target, state):
            raise ValueError(f"changing the state of {type(target).__name__}")

    def _array(self, version: Any, shape: Any, dtype: Any, fortran: Any, held: Any) -> NDArray[Any]:
        if type(version) is not int or version != 1 or fortran is not False:
            raise ValueError("the state of an array in another format")
        if not isinstance(dtype, np.dtype) or type(held) is not bytearray:
            raise ValueError("an array without a data type, or without bytes")
        if type(shape) is not tuple or len(shape) > 4 or not all(map(_is_size, shape)):
            raise ValueError(f"an array of shape {quoted(shape)}")
        if math.prod(shape) * dtype.itemsize != len(held):
            raise ValueError(f"an array whose shape does not match its {len(held)} bytes")
        values = np.frombuffer(bytes(held), dtype).reshape(shape)
        self._held -= len(held)
        held.clear()
        return values


def _is_plain(dtype: "np.dtype[Any]", state: tuple[Any, ...]) -> bool:
    """Whether a pickled state describes a plain data type with the expected byte order."""
    if len(state) < 5 or type(state[1]) is not str or state[1] != dtype.str[0]:
        return False
    return all(value is None for value in state[2:5])


def _is_size(value: Any) -> bool:
    return type(value) is int and 0 <= value < MAX_SIZE


_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
_TEXTS = ("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8")
_BYTES = ("SHORT_BINBYTES", "BINBYTES", "BINBYTES8")
_ACTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    **dict.fromkeys(("PROTO", "FRAME", "STOP"), lambda machine, _: None),
    "NONE": lambda machine, _: machine._push(None),
    "NEWTRUE": lambda machine, _: machine._push(True),
    "NEWFALSE": lambda machine, _: machine._push(False),
    "EMPTY_LIST": lambda machine, _: machine._push([]),
    "EMPTY_TUPLE": lambda machine, _: machine._push(()),
    "EMPTY_DICT": lambda machine, _: machine._push({}),
    **dict.fromkeys((*_NUMBERS, *_TEXTS, *_BYTES), _Machine._push),
    **dict.fromkeys(("BINGET", "LONG_BINGET"), _Machine._get),
    **dict.fromkeys(("BINPUT", "LONG_BINPUT"), _Machine._put),
    "MEMOIZE": lambda machine, _: machine._put(len(machine._memo)),
    "MARK": lambda machine, _: machine._marks.append(len(machine._stack)),
    "TUPLE": lambda machine, _: machine._stack.append(tuple(machine._pop_mark())),
    "TUPLE1": lambda machine, _: machine._stack.append(machine._pop_last(1)),
    "TUPLE2": lambda machine, _: machine._stack.append(machine._pop_last(2)),
    "TUPLE3": lambda machine, _: machine._stack.append(machine._pop_last(3)),
    "APPEND": lambda machine, _: machine._append([machine._stack.pop()]),
    "APPENDS": lambda machine, _: machine._append(machine._pop_mark()),
    "SETITEM": lambda machine, _: machine._set([machine._stack.pop(-2), machine._stack.pop()]),
    "SETITEMS": lambda machine, _: machine._set(machine._pop_mark()),
    "GLOBAL": lambda machine, argument: machine._global(*argument.split(" ", 1)),
    "STACK_GLOBAL": _Machine._stack_global,
    "REDUCE": _Machine._call,
    "NEWOBJ": _Machine._new,
    "BUILD": _Machine._build,
}
