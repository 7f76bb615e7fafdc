"""What both commands share at the terminal: errors in one line, exit codes, JSON."""

import atexit
import gc
import inspect
import io
import json
import math
import re
import shutil
import sys
import textwrap
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr
from dataclasses import MISSING, dataclass, fields
from functools import partial, wraps
from importlib import import_module
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NoReturn,
    TextIO,
    get_args,
    get_origin,
    get_type_hints,
)
from unicodedata import category

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from photocal.base.errors import (
    ConfigurationError,
    InputMalformedError,
    PhotocalError,
    ProgramMissingError,
    of_system,
)
from photocal.base.options import Option, Options

if TYPE_CHECKING:
    from photocal.base.sentences import Texts


class _Late(Mapping[str, Any]):
    """Commands by name; the module of each is imported when it is asked for."""

    def __init__(self, places: Mapping[str, str]) -> None:
        self._places, self._made = places, dict[str, Any]()

    def __getitem__(self, name: str) -> Any:
        """Make the command once."""
        if name not in self._made:
            module, _, attribute = self._places[name].partition(":")
            found = getattr(import_module(module), attribute)
            if not isinstance(found, typer.Typer):
                alone = typer.Typer(**_SHARED)
                alone.command(name, cls=_Command)(found)
                found = alone
            self._made[name] = typer.main.get_command(found)
            self._made[name].name = name
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        """Name them in their order."""
        return iter(self._places)

    def __len__(self) -> int:
        """Count them."""
        return len(self._places)


class _Context(typer.Context):
    """A call of a command, whose help is in the language of the person."""

    def make_formatter(self) -> Any:
        """Make what writes the help; each text goes through `said`, which the program hands in."""
        formatter: Any = super().make_formatter()
        said: Callable[[str], str] = self.obj or str
        usage, heading, table = (getattr(formatter, f"write_{part}") for part in ("usage", "heading", "dl"))

        def names(line: str) -> str:
            """Say the placeholders of a usage, and the kinds of values."""
            return re.sub(r"[A-Z][\w.=|:-]+", lambda found: said(found[0]), kinds(line))

        def meaning(cell: str) -> str:
            """Say what an option is for; behind it stand its default and limits in brackets."""
            whole, gap, limits = cell.partition("  [")
            return (
                said(whole)
                + gap
                + re.sub(r"(default|env var)(?=: )|required", lambda found: said(found[0]), limits)
            )

        def paragraphs(whole: str) -> str:
            """Say what a command does; options in it stay whole, to be copied."""
            indent = " " * formatter.current_indent
            fold = partial(
                textwrap.fill,
                width=formatter.width,
                initial_indent=indent,
                subsequent_indent=indent,
                break_on_hyphens=False,
            )
            return "\n\n".join(fold(said(" ".join(one.split()))) for one in whole.split("\n\n"))

        formatter.write_usage = lambda program, line="", _=None: usage(
            program, names(line), f"{said('Usage:')} "
        )
        formatter.write_heading = lambda title: heading(said(title))
        formatter.write_text = lambda whole: formatter.write(paragraphs(whole) + "\n")
        formatter.write_dl = lambda rows, **settings: table(
            [(names(name), meaning(cell)) for name, cell in rows], **settings
        )
        return formatter


def kinds(line: str) -> str:
    """Say the kinds of an option's values in words: typer has names of types, such as `<float range>`.

    An argument has a name that tells its kind.
    """
    words = {"str": " TEXT", "path": " PATH", "int": " INTEGER", "float": " NUMBER"}
    of_option = line.startswith("-")
    return re.sub(
        r" <(?:list\[)?(\w+)[^>]*>", lambda found: words[found[1].lower()] if of_option else "", line
    )


class _Command(TyperCommand):
    """A command whose help is in the language of the person."""

    context_class = _Context


class _Commands(TyperGroup):
    """Commands that the help lists with their whole summaries, without importing them."""

    context_class = _Context
    places: ClassVar[Mapping[str, str]] = {}

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = _Late(self.places)
        for own in self.params:
            own.process_value = partial(_as_given, own.process_value)  # type: ignore[method-assign]

    def get_help_option(self, ctx: Any) -> Any:
        """Return the option --help with a default that needs no conversion: that costs 0.1 s of imports."""
        found = super().get_help_option(ctx)
        if found is not None:
            found.default = False
        return found

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, _summary(place)) for name, place in self.places.items()])


def _summary(place: str) -> str:
    """First line of a command's docstring, or the help of a group: read, for imports would cost seconds."""
    from importlib import resources

    module, _, name = place.partition(":")
    package, _, file = module.rpartition(".")
    source = resources.files(package).joinpath(f"{file}.py").read_text(encoding="utf-8")
    said = re.search(rf'(?ms)^(?:def {name}\(.*?"""|{name} = application\(\s*")(.+?)[",]*$', source)
    return said[1] if said else ""


def _as_given(convert: Callable[[Any, Any], Any], context: Any, value: Any) -> Any:
    """Convert an option that was given: what converts costs 0.3 s of imports, also before a help below."""
    return convert(context, value) if value else value


_SHARED: dict[str, Any] = {
    "no_args_is_help": True,
    "add_completion": False,
    "pretty_exceptions_enable": False,
    # Plain help: the styled one costs a tenth of a second of imports.
    "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def application(help_text: str, places: Mapping[str, str] | None = None) -> typer.Typer:
    """Make a command line application: of commands that are imported one by one, or that are added to it.

    places: of the commands by their names, as module:function; the list has what their docstrings say first.
    """
    if places is None:
        return typer.Typer(help=help_text, **_SHARED)
    app = typer.Typer(cls=type("Commands", (_Commands,), {"places": places}), help=help_text, **_SHARED)
    app.callback()(_of_program)
    return app


def _version(asked: bool) -> None:
    if asked:
        from photocal.base.version import __version__

        typer.echo(f"photocal {__version__}")
        raise typer.Exit


def option(text: str, *names: str, **settings: Any) -> Any:
    """Describe an option of a command: its help, and its names where they are not that of the parameter."""
    if "--lang" in names:
        settings["callback"] = _asked_language
    return typer.Option(*names, help=text, **settings)


def _asked_language(language: str) -> str:
    """Refuse a language without texts before the work of a command, not where its texts are written."""
    from photocal.base.sentences import known_language

    return known_language(language) if language else ""


def argument(text: str, **settings: Any) -> Any:
    """Describe an argument of a command by its help."""
    return typer.Argument(help=text, **settings)


def spread(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command of a function that takes `Options`: each of their fields becomes an option of its own.

    The other parameters are described as for typer (`option`, `argument`); the help lists all in their order.
    """
    hints = get_type_hints(command, include_extras=True)
    taken: dict[str, Any] = {
        name: hint for name, hint in hints.items() if isinstance(hint, type) and issubclass(hint, Options)
    }
    parameters = list[inspect.Parameter]()
    for own in inspect.signature(command).parameters.values():
        spread_out = _parameters(taken[own.name]) if own.name in taken else [own]
        parameters += [
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints.get(one.name, one.annotation))
            for one in spread_out
        ]

    @wraps(command)
    def called(**given: Any) -> None:
        """Call the command with options gathered from the arguments."""
        for name, kind in taken.items():
            values = {field.name: given.pop(field.name) for field in fields(kind)}
            # typer knows lists, frozen options hold tuples.
            listed = {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
            given[name] = kind(**values | listed)
        command(**given)

    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {one.name: one.annotation for one in parameters}
    return called


def _parameters(kind: type[Any]) -> list[inspect.Parameter]:
    hints, parameters = get_type_hints(kind, include_extras=True), list[inspect.Parameter]()
    for field in fields(kind):
        value_type: Any
        value_type, *notes = get_args(hints[field.name])
        help_of = next(part for part in notes if isinstance(part, Option))
        default: Any = inspect.Parameter.empty if field.default is MISSING else field.default
        if get_origin(value_type) is tuple and get_args(value_type)[1:] == (Ellipsis,):
            value_type, default = types.GenericAlias(list, get_args(value_type)[:1]), list(default)
        described = option(help_of.text, *help_of.names, min=help_of.least, max=help_of.most)
        annotation = Annotated[value_type, described]
        parameters.append(
            inspect.Parameter(
                field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
            )
        )
    return parameters


AsJson = Annotated[bool, option("Print the figures as JSON.", "--json")]
Language = Annotated[
    str, option("Language of the texts: en or pt-BR; default: that of LANG.", "--lang", "--language")
]


def _of_program(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version.", callback=_version)] = False,
    language: Language = "",
) -> None:
    del version
    # The help has been printed by now, in that language.
    if language:
        refuse_before(context)


def refuse_before(context: typer.Context) -> None:
    """Refuse an option of a command that stands before it."""
    what, remedy = "an option comes before the command", f"put it after {context.invoked_subcommand}"
    raise ConfigurationError(what, remedy)


@dataclass(frozen=True, kw_only=True)
class Answering(Options):
    """How a command answers: in which language, or as JSON."""

    language: Annotated[
        str, Option("Language of the texts: en or pt-BR; default: that of LANG.", ("--lang", "--language"))
    ] = ""
    as_json: Annotated[bool, Option("Print the figures as JSON.", ("--json",))] = False


Details = Annotated[bool, option("Print all tests, figures and findings, not only the verdict.", "--details")]
Address = Annotated[str, option("HOST:PORT of the page. Beyond this computer the page demands a token.")]


def printable(text: str) -> str:
    """Return a text from outside without what would steer a terminal: control characters become dots.

    Blanks of whatever width become blanks.
    """
    return "".join(c if c.isprintable() else " " if category(c) == "Zs" else "·" for c in text)


# What typer raises for a call that it does not understand: its name differs between versions.
_Misuse: type[Any] = typer.BadParameter.__mro__[1]


def run(app: Callable[..., Any], texts: Callable[[str], "Texts"], commands: str) -> None:
    """Run an application; failures that we know become one line and their exit code.

    Help and failures are said in the language of the person.

    texts: gives the texts of a language.
    commands: package that has the texts of the help.
    """

    def refused(line: str) -> str:
        """Say a refusal in the language of the person."""
        from photocal.base.sentences import spoken_to

        return texts(spoken_to(sys.argv[1:])).refused(line)

    def helped(text: str) -> str:
        """Say a text of the help."""
        from photocal.base.sentences import help_texts, spoken_to

        # The help in English answers without reading any texts.
        language = spoken_to(sys.argv[1:])
        return text if language == "en" else help_texts(commands, language).helped(text)

    # Into a terminal or file of another encoding goes a question mark for a sign that it does not have.
    if isinstance(sys.stdout, io.TextIOWrapper) and not sys.stdout.encoding.lower().startswith("utf"):
        sys.stdout.reconfigure(errors="replace")
    # At its end the interpreter would look at every object for half a second; nothing is left to be freed.
    atexit.register(gc.freeze)
    # By its usual limit it would look at them again and again while modules are loaded: a fifth of that time.
    rarely = 100_000
    gc.set_threshold(rarely)
    try:
        sys.exit(app(standalone_mode=False, obj=helped))
    except _Misuse as misuse:
        with redirect_stderr(io.StringIO()) as told:
            misuse.show()
        for line in told.getvalue().splitlines():
            sys.stderr.write(f"{helped(line)}\n")
        sys.exit(misuse.exit_code)
    except typer.Abort:
        # Ctrl-C, as older typer tells it.
        sys.exit(130)
    except PhotocalError as failure:
        _end(failure, refused)
    except ModuleNotFoundError as missing:
        name = (missing.name or "").partition(".")[0]
        if name in ("acquire", "drivers", "photocal", ""):
            raise
        # A recorder is installed without what only the processing needs.
        what = f"the package {name} is missing"
        _end(ProgramMissingError(what, "run: pip install 'photocal[process]'"), refused)
    except OSError as refusal:
        _end(of_system(refusal), refused)
    except UnicodeEncodeError as failure:
        name = failure.object[:80].encode("utf-8", "backslashreplace").decode()
        what = f"a name is not in UTF-8, the encoding of names ({name})"
        _end(InputMalformedError(what, "rename the file or folder"), refused)


def _end(failure: PhotocalError, said: Callable[[str], str]) -> NoReturn:
    """Say in one line, and by the exit code, what went wrong."""
    # Nowhere to say it (`2>&-`) is no failure of its own.
    typer.echo(error_lines(failure, said), err=True, nl=False)
    sys.exit(failure.exit_code)


def error_lines(failure: PhotocalError, said: Callable[[str], str] = str) -> str:
    """Return what is said of a failure: one line, and its details below."""
    lines = (said(f"error: {failure}"), *map("  ".__add__, failure.details))
    return "".join(f"{printable(line)}\n" for line in lines)


def numbers_of(text: str, option: str, form: str) -> list[float]:
    """Numbers with commas between them, as an option takes them; `form` names each, and their unit.

    raises ConfigurationError: when they are not as many finite numbers.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != form.partition(":")[0].count(",") + 1 or not all(map(math.isfinite, values)):
        raise ConfigurationError(f"{text!r} is not of the form {form}", "write it in this form", where=option)
    return values


def answer(as_json: bool, figures: Callable[[], Any], text: Callable[[], str]) -> None:
    """Print an answer for a program or for a person; lines wider than a terminal go on below, indented."""
    said = answered(as_json, figures, text)
    if not as_json and sys.stdout is not None and sys.stdout.isatty():
        said = "\n".join(_folded(line, shutil.get_terminal_size().columns) for line in said.split("\n"))
    typer.echo(said)


def answered(as_json: bool, figures: Callable[[], Any], text: Callable[[], str]) -> str:
    """Return an answer for a program or for a person."""
    if as_json:
        from photocal.base.arrays import as_plain

        return json.dumps(as_plain(figures()), indent=2, allow_nan=False)
    return "\n".join(map(printable, text().split("\n")))


def _folded(line: str, width: int) -> str:
    """Break a line between words; names of files stay whole."""
    below = " " * (len(line) - len(line.lstrip()) + 4)
    lines = textwrap.wrap(
        line,
        max(width, 2 * len(below)),
        subsequent_indent=below,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(lines)


def write_through(stream: TextIO, text: str) -> None:
    """Write to a standard stream at once, past its buffers.

    What waits in a buffer is written by the end of the interpreter, which a terminal that is paused would
    keep from ending.
    """
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    if raw is None:
        stream.write(text)
        stream.flush()
        return
    left = memoryview(text.encode(stream.encoding or "utf-8", "backslashreplace"))
    while left:
        written = raw.write(left)
        if written is None:
            raise BlockingIOError("accepts no output now")
        left = left[written:]


@dataclass(frozen=True)
class Check:
    """A check before work: good, poor (something will be missing or slow) or bad, and the remedy."""

    part: str
    state: Literal["good", "poor", "bad"]
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        """Say it in a line."""
        return f"{self.state:<5} {self.said()}"

    def said(self) -> str:
        """Say it without its state."""
        return f"{self.part}: {self.text}" + (f"; {self.remedy}" if self.remedy else "")
