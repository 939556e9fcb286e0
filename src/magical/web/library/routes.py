"""The HTTP routes of the library. What takes long is computed in threads: the players go on."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from magical.demos.store.trajectory import Actor
from magical.envs.keys import controls_of
from magical.envs.seeds import sample_training_seeds
from magical.errors import BusyError, MagicalError, MessageError, NotFoundError
from magical.scene.actions import ACTION_NAMES
from magical.web.library.policies import Policies, episode_probabilities
from magical.web.library.queries import (
    PAGE,
    EpisodeQuery,
    FramesQuery,
    ListQuery,
    ProbabilitiesQuery,
    parse_query,
    parse_rollout,
)
from magical.web.library.rollouts import roll_out
from magical.web.library.sources import ROLLOUTS, Sources
from magical.web.library.viewing import ViewedEpisode
from magical.web.messages import MAX_BYTES, RateLimit, json_object

REQUEST_RATE = 40.0  # requests a second, of all pages together
REQUEST_BURST = 120.0  # requests
MAX_WAITING = 32  # requests that are computed or wait for it, beyond which none is accepted
MAX_WAITING_ROLLOUTS = 4  # of these, rollouts and probabilities of policies
OPEN_EPISODES = 8  # that are kept in memory

_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class LibrarySettings:
    """What the page lists: folders of datasets, and folders of runs or with runs in them."""

    datasets: tuple[Path, ...] = ()
    runs: tuple[Path, ...] = ()


class Worker:
    """One thread with a bounded queue, so that a page cannot pile up work."""

    def __init__(self, name: str, limit: int) -> None:
        self._executor = ThreadPoolExecutor(1, name)
        self._limit = limit
        self._waiting = 0

    async def run(self, work: Callable[..., _Result], *arguments: Any) -> _Result:
        """The result of the work in the thread; raises `BusyError` where the queue is full."""
        if self._waiting >= self._limit:
            raise BusyError("the server is busy with other requests; try again in a moment")
        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._executor, work, *arguments)
        future.add_done_callback(lambda _: self._finished())
        return await future

    def _finished(self) -> None:
        self._waiting -= 1

    def close(self) -> None:
        """End the thread after what it is doing."""
        self._executor.shutdown(wait=True, cancel_futures=True)


class Library:
    """Datasets, runs and rollouts of a server, as its page asks for them.

    Args:
        settings: what is listed.
        clock: the time in seconds.
        rng: samples the seeds of scenes.

    Raises:
        DatasetError: a folder holds no dataset, or a damaged one.
        RunFolderError: a folder of runs does not exist.
    """

    def __init__(
        self, settings: LibrarySettings, clock: Callable[[], float], rng: np.random.Generator
    ) -> None:
        self.sources = Sources(settings.datasets)
        self.policies = Policies(settings.runs)
        self._clock = clock
        self._rng = rng
        self._limit = RateLimit(REQUEST_RATE, REQUEST_BURST, clock())
        self._reader = Worker("reader", MAX_WAITING)  # reads files, renders frames
        self._runner = Worker("runner", MAX_WAITING_ROLLOUTS)  # runs policies
        self._open: OrderedDict[tuple[str, int], ViewedEpisode] = OrderedDict()

    def routes(self) -> list[BaseRoute]:
        """All routes; none takes a path."""
        return [
            Route("/api/library", self._answering(self._list_library)),
            Route("/api/episodes", self._answering(self._list_episodes)),
            Route("/api/episode", self._answering(self._show_episode)),
            Route("/api/frames", self._answering(self._send_frames)),
            Route("/api/probabilities", self._answering(self._send_probabilities)),
            Route("/api/rollouts", self._answering(self._roll_out), methods=["POST"]),
        ]

    def close(self) -> None:
        """End the threads."""
        self._reader.close()
        self._runner.close()

    # Answers

    async def _list_library(self, request: Request) -> Response:
        parse_no_query(request)
        policies = await self._reader.run(self.policies.refresh)
        return JSONResponse(
            {
                "sources": [{"key": key, "name": source.name} for key, source in self.sources],
                "policies": [
                    {"number": i, "name": p.name, "tasks": p.tasks, "algorithm": p.algorithm}
                    for i, p in enumerate(policies)
                ],
                "actions": [
                    {"name": name, "controls": controls_of(action)}
                    for action, name in enumerate(ACTION_NAMES)
                ],
                "actors": [actor.name.lower() for actor in Actor],
            }
        )

    async def _list_episodes(self, request: Request) -> Response:
        query = parse_query(ListQuery, fields(request))
        source = self.sources.find(query.source)
        found = await self._reader.run(source.summaries)
        summaries = [one for one in found if query.task in ("", one.env_id.task)]
        newest = summaries[::-1][query.skip : query.skip + PAGE]
        return JSONResponse(
            {"total": len(summaries), "episodes": [asdict(summary) for summary in newest]}
        )

    async def _show_episode(self, request: Request) -> Response:
        query = parse_query(EpisodeQuery, fields(request))
        return JSONResponse(await self._reader.run(self._details, query.source, query.episode))

    async def _send_frames(self, request: Request) -> Response:
        query = parse_query(FramesQuery, fields(request))
        content = await self._reader.run(self._frames, query)
        return Response(content, media_type="application/octet-stream")

    async def _send_probabilities(self, request: Request) -> Response:
        query = parse_query(ProbabilitiesQuery, fields(request))
        return JSONResponse(await self._runner.run(self._probabilities, query))

    async def _roll_out(self, request: Request) -> Response:
        parse_no_query(request)
        wanted = parse_rollout(json_object(await body(request)))
        seed = sample_training_seeds(self._rng, 1)[0] if wanted.seed is None else wanted.seed
        arguments = (self.policies, wanted.policy, wanted.env_id, seed)
        episode = await self._runner.run(roll_out, *arguments)
        return JSONResponse({"source": ROLLOUTS, "episode": self.sources.rollouts.add(episode)})

    # In threads

    def _viewed(self, source: str, number: int) -> ViewedEpisode:
        key = source, number
        if key not in self._open:
            self._open[key] = ViewedEpisode(self.sources.find(source).read(number))
            while len(self._open) > OPEN_EPISODES:
                self._open.popitem(last=False)
        self._open.move_to_end(key)
        return self._open[key]

    def _details(self, source: str, number: int) -> dict[str, Any]:
        return self._viewed(source, number).details

    def _frames(self, query: FramesQuery) -> bytes:
        viewed = self._viewed(query.source, query.episode)
        return viewed.frames(query.view, query.first, query.count)

    def _probabilities(self, query: ProbabilitiesQuery) -> list[list[float]]:
        policy = self.policies.load(query.policy)
        episode = self.sources.find(query.source).read(query.episode)
        self.policies.find(query.policy).check(episode.env_id)
        rows: list[list[float]] = episode_probabilities(policy, episode).round(4).tolist()
        return rows

    def _answering(self, answer: Callable[[Request], Any]) -> Callable[[Request], Any]:
        """A route that limits the rate of requests, and says what is wrong with one."""

        async def limited(request: Request) -> Response:
            if not self._limit.allows(self._clock()):
                return _problem(429, "too many requests; try again in a moment")
            try:
                response: Response = await answer(request)
            except MagicalError as error:
                return _problem(_status(error), str(error))
            return response

        return limited


def fields(request: Request) -> dict[str, str]:
    """The fields of a request's address without the token; each may be given once.

    Raises:
        MessageError: a field is there twice.
    """
    given = [item for item in request.query_params.multi_items() if item[0] != "token"]
    if len(dict(given)) < len(given):
        raise MessageError("expected each field once")
    return dict(given)


def parse_no_query(request: Request) -> None:
    """Raise `MessageError` where an address has fields other than the token."""
    if fields(request):
        raise MessageError("expected no fields but the token")


async def body(request: Request) -> str:
    """The text of a request's body, of at most `MAX_BYTES`; raises `MessageError`."""
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > MAX_BYTES:
            raise MessageError(f"body: expected at most {MAX_BYTES} bytes")
    return content.decode(errors="replace")


def _status(error: MagicalError) -> int:
    kinds = {MessageError: 400, NotFoundError: 404, BusyError: 503}
    return next((status for kind, status in kinds.items() if isinstance(error, kind)), 422)


def _problem(status: int, what: str) -> JSONResponse:
    return JSONResponse({"problem": what}, status_code=status)
