"""Reading published pickles without executing anything.

A pickle is a program for a small stack machine whose opcodes may import and call anything. The
machine here implements only the opcodes that build plain data. The five global names in the
published files are tokens to it: "calling" one checks its arguments and builds a value of this
module; any other name is refused. Nothing that a pickle names is looked up, imported or called.

What the machine builds may be nested without bound, or share parts without bound, so values are
never hashed, compared or printed before their type is checked.
"""

import math
import pickletools
from collections.abc import Callable, Iterator
from gzip import GzipFile
from typing import IO, Any, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from magical.errors import UnsafeFileError
from magical.messages import printable, quoted

# Bounds far above what the largest published file needs: 17,500 opcodes, items of 442,368 bytes,
# and next to no bytes that do not become part of an array at once.
MAX_OPCODES = 200_000
MAX_ITEM = 1 << 20  # bytes of one string, array or line
MAX_HELD = 16 << 20  # bytes of strings and byte strings in memory at one time
MAX_KEPT = 64 << 20  # bytes of arrays after `reduce`
MAX_SIZE = 1 << 31  # of one dimension of an array

Reduce = Callable[[NDArray[Any]], NDArray[Any]]


class Name(NamedTuple):
    """A token for a global name in a pickle."""

    module: str
    name: str

    def __str__(self) -> str:
        return printable(f"{self.module}.{self.name}")


DTYPE = Name("numpy", "dtype")
NDARRAY = Name("numpy", "ndarray")
RECONSTRUCT = Name("numpy.core.multiarray", "_reconstruct")
ORDERED_DICT = Name("collections", "OrderedDict")
RECORD = Name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
ALLOWED = (DTYPE, NDARRAY, RECONSTRUCT, ORDERED_DICT, RECORD)
DTYPES = {"u1": "|", "i8": "<", "f8": "<", "f4": "<"}  # code: byte order


class Record(NamedTuple):
    """The named tuple of the published files."""

    acts: Any
    obs: Any
    rews: Any
    infos: Any


class _Bytes:
    """The bytes of one array; released when the array is built."""

    def __init__(self, data: bytes) -> None:
        self.data: bytes | None = data


class _DType:
    """A data type by its code, one of `DTYPES`."""

    def __init__(self, code: str) -> None:
        self.code = code

    def has_state(self, state: tuple[Any, ...]) -> bool:
        """Whether a pickled state is that of a plain data type of the expected byte order."""
        if len(state) < 5 or type(state[1]) is not str or state[1] != DTYPES[self.code]:
            return False
        return all(value is None for value in state[2:5])


def _is_dtype(code: Any) -> bool:
    return type(code) is str and code in DTYPES


class Array:
    """An array; `values` is `None` until its state is set."""

    values: NDArray[Any] | None = None


class _Reader:
    """The file that pickletools reads from, with a bound on the size of one item."""

    def __init__(self, file: IO[bytes] | GzipFile) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        if size > MAX_ITEM:
            raise ValueError(f"an item of {size} bytes, more than {MAX_ITEM}")
        return self._file.read(size)

    def readline(self) -> bytes:
        return self._file.readline(MAX_ITEM)

    def tell(self) -> int:
        return self._file.tell()


def load(file: IO[bytes] | GzipFile, reduce: Reduce) -> Any:
    """The data of a pickle: None, bool, int, float, str, list, tuple, dict, `Array`, `Record`.

    `reduce` is applied to every array as it is read, so that large ones need not be kept.

    Raises:
        UnsafeFileError: anything else is in it, or it is damaged.
    """
    machine, reader = _Machine(reduce), _Reader(file)
    position: int | None = 0
    for count, (opcode, argument, position) in enumerate(_opcodes(reader)):
        if count > MAX_OPCODES:
            _refuse(position, f"more than {MAX_OPCODES} opcodes")
        try:
            machine.do(opcode.name, argument)
        except (IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
            _refuse(position, f"{opcode.name}: {error}", error)
    if reader.read(1):
        _refuse(position, "data after the end")
    return machine.result()


def _opcodes(reader: _Reader) -> Iterator[tuple[Any, Any, int | None]]:
    try:
        yield from pickletools.genops(cast("IO[bytes]", reader))
    except ValueError as error:
        _refuse(reader.tell(), f"damaged: {error}", error)


def _refuse(position: int | None, what: str, cause: Exception | None = None) -> NoReturn:
    where = "" if position is None else f" at byte {position}"
    raise UnsafeFileError(f"refused{where}: {printable(what)}; nothing was executed") from cause


class _Machine:
    """The stack, the marks on it, and the memo."""

    def __init__(self, reduce: Reduce) -> None:
        self._reduce = reduce
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        self._held = 0
        self._kept = 0

    def do(self, opcode: str, argument: Any) -> None:
        """Execute one opcode; raises ValueError for one that is not implemented."""
        if opcode in _IGNORED:
            return
        if opcode in _CONSTANTS:
            self._stack.append(_CONSTANTS[opcode]())
        elif opcode in _PUSHES:
            self._push(argument)
        elif opcode in _GETS:
            self._stack.append(self._memo[argument])
        elif opcode in _PUTS:
            self._memo[argument] = self._stack[-1]
        elif opcode in _ACTIONS:
            _ACTIONS[opcode](self, argument)
        else:
            raise ValueError("not an opcode of plain data")

    def result(self) -> Any:
        """The one value on the stack at the end."""
        if len(self._stack) != 1 or self._marks:
            _refuse(None, f"{len(self._stack)} values left, expected 1")
        return self._stack[0]

    def _push(self, argument: Any) -> None:
        if isinstance(argument, str | bytes):
            self._held += len(argument)
            if self._held > MAX_HELD:
                raise ValueError(f"more than {MAX_HELD} bytes that are not part of an array")
        self._stack.append(_Bytes(argument) if isinstance(argument, bytes) else argument)

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _pop_mark(self) -> list[Any]:
        start = self._marks.pop()
        items = self._stack[start:]
        del self._stack[start:]
        return items

    def _pop(self, kind: type) -> Any:
        if self._marks and len(self._stack) <= self._marks[-1]:
            raise ValueError("the stack is empty")
        value = self._stack.pop()
        if type(value) is not kind:
            raise ValueError(f"expected {kind.__name__}, found {type(value).__name__}")
        return value

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._pop_mark()))

    def _tuple_of(self, count: int) -> None:
        if len(self._stack) - (self._marks[-1] if self._marks else 0) < count:
            raise ValueError("the stack is empty")
        items = tuple(self._stack[-count:])
        del self._stack[-count:]
        self._stack.append(items)

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

    def _global(self, argument: str) -> None:
        module, name = argument.split(" ", 1)
        self._stack.append(_allowed(module, name))

    def _stack_global(self, _: Any) -> None:
        name, module = self._pop(str), self._pop(str)
        self._stack.append(_allowed(module, name))

    def _call(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        if name == ORDERED_DICT and not arguments:
            self._stack.append({})
        elif name == DTYPE and len(arguments) == 3 and _is_dtype(arguments[0]):
            self._stack.append(_DType(arguments[0]))
        elif name == RECONSTRUCT and len(arguments) == 3 and arguments[0] is NDARRAY:
            self._stack.append(Array())
        else:
            raise ValueError(f"calling {name} with {len(arguments)} unexpected arguments")

    def _new(self, _: Any) -> None:
        arguments, name = self._pop(tuple), self._pop(Name)
        if name != RECORD or len(arguments) != len(Record._fields):
            raise ValueError(f"constructing {name} from {len(arguments)} arguments")
        self._stack.append(Record(*arguments))

    def _build(self, _: Any) -> None:
        state, target = self._pop(tuple), self._stack[-1]
        if type(target) is Array and target.values is None:
            if len(state) != 5:
                raise ValueError("the state of an array in another format")
            target.values = self._reduce(self._array(*state))
            self._kept += target.values.nbytes
            if self._kept > MAX_KEPT:
                raise ValueError(f"arrays of more than {MAX_KEPT} bytes")
        elif type(target) is not _DType or not target.has_state(state):
            raise ValueError(f"changing the state of {type(target).__name__}")

    def _array(self, version: Any, shape: Any, dtype: Any, fortran: Any, held: Any) -> NDArray[Any]:
        if type(version) is not int or version != 1 or fortran is not False:
            raise ValueError("the state of an array in another format")
        if type(dtype) is not _DType:
            raise ValueError("an array without a data type")
        if type(shape) is not tuple or len(shape) > 4 or not all(map(_is_size, shape)):
            raise ValueError(f"an array of shape {quoted(shape)}")
        if type(held) is not _Bytes or held.data is None:
            raise ValueError("an array without its own bytes")
        kind = np.dtype(DTYPES[dtype.code] + dtype.code)
        if math.prod(shape) * kind.itemsize != len(held.data):
            raise ValueError(f"an array whose shape does not match its {len(held.data)} bytes")
        values = np.frombuffer(held.data, kind).reshape(shape)
        self._held -= len(held.data)
        held.data = None
        return values


def _is_size(value: Any) -> bool:
    return type(value) is int and 0 <= value < MAX_SIZE


def _allowed(module: str, name: str) -> Name:
    for allowed in ALLOWED:
        if (module, name) == (allowed.module, allowed.name):
            return allowed
    found = printable(f"{module}.{name}", 60)
    raise ValueError(f"expected only numpy arrays and {RECORD.name}, found the name {found}")


_IGNORED = frozenset({"PROTO", "FRAME", "STOP"})
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "EMPTY_DICT": dict,
}
_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
_TEXTS = ("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8")
_PUSHES = frozenset({*_NUMBERS, *_TEXTS, "SHORT_BINBYTES", "BINBYTES", "BINBYTES8"})
_GETS = frozenset({"BINGET", "LONG_BINGET"})
_PUTS = frozenset({"BINPUT", "LONG_BINPUT"})
_ACTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    "MEMOIZE": _Machine._memoize,
    "MARK": _Machine._mark,
    "TUPLE": _Machine._tuple,
    "TUPLE1": lambda machine, _: machine._tuple_of(1),
    "TUPLE2": lambda machine, _: machine._tuple_of(2),
    "TUPLE3": lambda machine, _: machine._tuple_of(3),
    "APPEND": lambda machine, _: machine._append([machine._stack.pop()]),
    "APPENDS": lambda machine, _: machine._append(machine._pop_mark()),
    "SETITEM": lambda machine, _: machine._set([machine._stack.pop(-2), machine._stack.pop()]),
    "SETITEMS": lambda machine, _: machine._set(machine._pop_mark()),
    "GLOBAL": _Machine._global,
    "STACK_GLOBAL": _Machine._stack_global,
    "REDUCE": _Machine._call,
    "NEWOBJ": _Machine._new,
    "BUILD": _Machine._build,
}
