"""Questions of a local page, checked, and their answers in JSON."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError, validate_call
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError, InputNotFoundError

Question = TypeVar("Question", bound=Table)


def telling(path: str, tell: Callable[[], Any]) -> Route:
    """Return a route that answers with what a function tells."""

    async def give(_: Request) -> Response:
        """Answer as JSON."""
        return JSONResponse(await run_in_threadpool(tell))

    return Route(path, give)


def finding(path: str, find: Callable[[dict[str, str]], Any]) -> Route:
    """Return a route that answers what stands in its path and query, by their names."""

    async def give(request: Request) -> Response:
        """Answer as JSON."""
        asked = {**request.query_params, **request.path_params}
        return JSONResponse(await run_in_threadpool(find, asked))

    return Route(path, give)


def doing(path: str, do: Callable[[bytes], Any]) -> Route:
    """Return a route that hands the body of a request to a function."""

    async def give(request: Request) -> Response:
        """Answer as JSON."""
        return JSONResponse(await run_in_threadpool(do, await json_body(request)))

    return Route(path, give, methods=["POST"])


def checked(kind: type[Question], body: bytes) -> Question:
    """Read a question; raises ConfigurationError when it is none of this kind."""
    with _of_the_page():
        return kind.model_validate_json(body)


def calling(do: Callable[..., Any], *given: Any) -> Callable[[bytes], Any]:
    """Return what calls a function with what a body names: its keywords, of the types in its signature.

    given: what the function takes before them.
    raises ConfigurationError: when a body names something else; what is returned does.
    """
    strict = ConfigDict(strict=True, allow_inf_nan=False)
    call, named = validate_call(config=strict)(partial(do, *given)), TypeAdapter(dict[str, Any])

    def answer(body: bytes) -> Any:
        """Call it."""
        with _of_the_page():
            return call(**named.validate_json(body))

    return answer


@contextmanager
def _of_the_page() -> Iterator[None]:
    """What is no question of ours is a ConfigurationError."""
    try:
        yield
    except ValidationError as failure:
        first = failure.errors()[0]
        what = ": ".join((".".join(map(str, first["loc"])), first["msg"])).lstrip(": ")
        raise ConfigurationError(what, "use the page", where="request") from failure


async def json_body(request: Request) -> bytes:
    """Read the body of a request; raises ConfigurationError when it is too long or no JSON."""
    # A form of another site cannot have this type.
    if request.headers.get("content-type") != "application/json":
        raise ConfigurationError("the request is no JSON", "use the page")
    longest_request = 10_000
    return await short_body(request, longest_request)


async def short_body(request: Request, longest: int) -> bytes:
    """Read the body of a request; raises ConfigurationError when it is longer than that many bytes."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > longest:
            raise ConfigurationError("the request is too long", "use the page")
    return bytes(body)


async def refusal(_: Request, failure: Exception) -> Response:
    """Answer with a failure that we know, in the words of the command line."""
    status = 404 if isinstance(failure, InputNotFoundError) else 422
    return JSONResponse({"error": str(failure)}, status)
