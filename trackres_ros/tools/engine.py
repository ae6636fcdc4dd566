# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs tasks on Dask: a cluster on this machine, or a running scheduler. Dask provides queue, workers and retries."""

from __future__ import annotations

import atexit
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.client import HTTPException
from importlib.util import find_spec
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.request import urlopen

from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.files.interpreter import SAFE

if TYPE_CHECKING:
    from distributed import Client

Work = TypeVar("Work")

LOCAL = "local"
CONNECT_S, PAGE_S = 10.0, 2.0
DEATHS = 3  # worker deaths with a task before they are the task's fault, as Dask defines it
AHEAD = 4  # tasks in Dask per thread of the workers: more would only fill the client's memory
LOUD = "distributed", "tornado", "asyncio"
SAID = "tcp://HOST:PORT of a running dask scheduler, or local"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class EngineGoneError(InputError):
    """The scheduler does not answer any more."""


@contextmanager
def engine(address: str, workers: int | None = None) -> Iterator[Client]:
    """A client of a scheduler, or of a cluster that lives as long as this.

    `address`: ``local``, or the address of a scheduler; `workers`: processes of a local cluster; by default as many as
    processors. Raises InputError if there is no scheduler.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.deploy.spec import close_clusters
    except ImportError:
        raise MissingExtraError("trackres fleet", "distributed", "fleet") from None
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in LOUD:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # one line reports the relevant part
    settings = {
        "distributed.scheduler.allowed-failures": DEATHS - 1,
        "distributed.comm.timeouts.connect": CONNECT_S,
        # In place of Dask's, which has glibc give memory back at every step: twice the processor time.
        "distributed.nanny.pre-spawn-environ": {**ONE_THREAD, **SAFE},
        "distributed.admin.tick.limit": "1h",
    }
    with dask.config.set(settings):
        if address == LOCAL:
            count = workers or len(os.sched_getaffinity(0))
            try:
                cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # a free port: there may be two runs
                    silence_logs=logging.CRITICAL,
                )
            except KeyboardInterrupt:  # Dask cannot close a cluster that is starting; its workers end with this process
                atexit.unregister(close_clusters)
                raise
            try:
                with Client(cluster, set_as_default=False) as client:
                    yield client
                    with suppress(TimeoutError):  # one that starts again cannot be closed cleanly
                        client.wait_for_workers(count, CONNECT_S)
            finally:
                try:
                    cluster.close()
                except Exception:  # Dask may fail at a worker that dies or starts just then; it ends with this process
                    atexit.unregister(close_clusters)
            return
        if not address.partition("://")[2]:
            raise InputError("--engine", address, SAID)
        try:
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            problem = f"{address}, where no scheduler answers ({one_line(str(error) or type(error).__name__)[:120]})"
            raise InputError("--engine", problem, SAID, "start one with: dask scheduler") from None
        with client:
            yield client


def dashboard(client: Client) -> str:
    """Address of Dask's own page, empty if none answers: it requires bokeh on the scheduler."""
    port = client.scheduler_info()["services"].get("dashboard")
    host = client.scheduler.address.partition("://")[2].rpartition(":")[0] if client.scheduler else ""
    if not (port and host):
        return ""
    page = f"http://{host}:{port}/status"
    try:
        with urlopen(page, timeout=PAGE_S) as answer:
            return page if answer.status == HTTPStatus.OK else ""
    except (OSError, HTTPException):
        return ""


def run_pieces(client: Client, function: Callable[[Work], Any], work: Iterable[Work]) -> Iterator[tuple[Work, Any]]:
    """Each piece of work with its result, or with the exception that ended it, in order of completion.

    Dask has only a few at a time, so that memory does not grow with the number of pieces. It blames a worker's death on all tasks
    of the worker. Those it gives up are repeated at the end, one at a time. Raises EngineGoneError if the scheduler is gone.
    """
    from distributed import KilledWorker

    threads = sum(client.nthreads().values()) if client.status == "running" else 1
    suspects = []
    for piece, result in _run_pieces(client, function, work, AHEAD * max(1, threads)):
        if isinstance(result, KilledWorker):
            suspects.append(piece)
        else:
            yield piece, result
    yield from _run_pieces(client, function, suspects, at_once=1)


def results(
    function: Callable[[Work], Any], work: Sequence[Work], address: str, workers: int | None = None, has_few: bool = False
) -> Iterator[tuple[Work, Any]]:
    """Each piece of work with its result, in order of completion; a few pieces, or all without Dask, in this process.

    Raises the exception that ended a piece.
    """
    if address == LOCAL and workers is None and (has_few or find_spec("distributed") is None):
        yield from ((piece, function(piece)) for piece in work)
        return
    with engine(address, workers) as client:
        for piece, result in run_pieces(client, function, work):
            if isinstance(result, BaseException):
                raise result
            yield piece, result


def _run_pieces(
    client: Client, function: Callable[[Work], Any], work: Iterable[Work], at_once: int
) -> Iterator[tuple[Work, Any]]:
    from distributed import as_completed

    pieces, pieces_by_key = iter(work), {}

    def submit(count: int) -> list[Any]:
        futures = [(client.submit(function, piece, pure=False), piece) for piece in islice(pieces, count)]
        pieces_by_key.update({future.key: piece for future, piece in futures})
        return [future for future, _ in futures]

    first_futures = submit(at_once)
    futures_done = as_completed(first_futures, loop=client.loop)
    del first_futures
    for future in futures_done:
        if future.status == "cancelled":
            raise _gone_error(client)
        try:  # a result lost with its worker is computed again
            result = future.exception() if future.status == "error" else future.result()
        except Exception as error:
            raise _gone_error(client) from error
        piece = pieces_by_key.pop(future.key)
        del future
        yield piece, result
        for next_future in submit(1):
            futures_done.add(next_future)


def _gone_error(client: Client) -> EngineGoneError:
    return EngineGoneError(
        "--engine", f"{client.scheduler.address if client.scheduler else 'a scheduler'}, which does not answer any more", SAID,
        "finished results are kept: run the same command again",
    )  # fmt: skip


def failure_text(error: BaseException) -> str:
    """Why a piece of work ended without a result."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return f"{DEATHS} workers died in sequence on this task alone, most likely out of memory"
    return one_line(f"{type(error).__name__}: {error}")
