"""Tables of a block folder: read whole, checked cell by cell, every complaint with its line."""

import codecs
import re
import unicodedata
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import ArrayLike

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError, InputNotFoundError, OutputError
from photocal.base.layers import SUFFIXES, file_of, read_layer

# As spreadsheets of half the world write them: 1234,5 and 1.234,5.
_COMMA = r"[+-]?(\d+|\d{1,3}(\.\d{3})+)(,\d+)?([eE][+-]?\d+)?"
_HEAD_BYTES = 1 << 20
# Lines among which the heads are.
_TITLES = 20
# Words of a head that do not say whose column it is.
_NO_HEADS = frozenset((
    "m", "metros", "meters", "metres", "ft", "feet", "usft", "ftus", "sft", "mm", "cm", "deg", "degrees",
    "graus", "utm", "grid", "coord", "coords", "coordenada", "coordenadas", "coordinate", "coordinates",
    "coordinata", "coordonnee", "koordinate",
))  # fmt: skip
# Tables of observations and residuals that are longer are written as Parquet.
LONG_TABLE = 500_000
MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


@dataclass(frozen=True)
class TextTable:
    """A table whose cells are still text (CSV) or typed (Parquet).

    lines: whether rows can be named by their line.
    separator: of the cells; where it is no comma, numbers may have a decimal comma.
    titles: lines before the heads, which have no cells; rows of a sheet with these.
    heads: of columns that got other names: as they stand in the file.
    kept: rows of the file that the table has; none where it has all.
    """

    path: Path
    columns: Any
    lines: bool
    separator: str = ","
    titles: int = 0
    heads: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[int, ...] = ()

    def __len__(self) -> int:
        return int(self.columns.num_rows)

    def has(self, name: str) -> bool:
        """Whether there is a column of this name."""
        return name in self.columns.column_names

    def place(self, row: int) -> str:
        """Name a row for a message."""
        row = self.kept[row] if self.kept else row
        if not self.lines:
            return f"{self.path}, row {self.titles + row + 1}"
        # Lines without content are skipped when reading, so that rows and lines may differ.
        seen = -1
        with self.path.open(encoding="utf-8", errors="replace") as text:
            for number, line in enumerate(text, start=1):
                seen += number > self.titles and bool(line.strip("\r\n"))
                if seen == row + 1:
                    return f"{self.path}, line {number}"
        return str(self.path)

    def only(self, rows: Sequence[int]) -> "TextTable":
        """Give the table of some rows, which keep their places in the file."""
        kept = tuple(self.kept[row] if self.kept else row for row in rows)
        return replace(self, columns=self.columns.take(pa.array(rows, pa.int64())), kept=kept)

    def names(self, column: str) -> tuple[Integers, tuple[str, ...]]:
        """Identifiers of a column: index of each row's name, and the distinct names in order."""
        cells = self.columns[column]
        if not pa.types.is_string(cells.type):
            cells = cells.cast(pa.string())
        cells = pc.utf8_trim_whitespace(cells)
        empty = pc.or_kleene(pc.is_null(cells), pc.equal(cells, ""))
        refuse(self, np.asarray(empty), f"{column} is empty", "give every row its name")
        encoded = cells.combine_chunks().dictionary_encode()
        return np.asarray(encoded.indices, dtype=np.int64), tuple(encoded.dictionary.to_pylist())

    def texts(self, column: str) -> tuple[str, ...]:
        """Texts of a column, empty where a cell is."""
        cells = pc.utf8_trim_whitespace(self.columns[column].cast(pa.string()))
        return tuple(pc.fill_null(cells, "").to_pylist())

    def unique_names(self, column: str) -> tuple[str, ...]:
        """Identifiers of a column in which no name may come twice."""
        index, names = self.names(column)
        if len(names) < len(index):
            first = np.zeros(len(names), dtype=np.int64)
            first[index[::-1]] = np.arange(len(index))[::-1]
            row = int(np.flatnonzero(first[index] != np.arange(len(index)))[0])
            raise InputMalformedError(
                f"{column} {names[index[row]]} is listed twice", "keep one of the rows", where=self.place(row)
            )
        return names

    def numbers(self, column: str, *, empty: float | None = None) -> Floats:
        """Numbers of a column; `empty` stands for empty cells, None forbids them."""
        # No coordinate and no sigma is larger; products of some of these are still numbers.
        largest = 1e30
        if not self.has(column):
            return np.full(len(self), np.nan if empty is None else empty)
        cells = self.columns[column]
        if pa.types.is_string(cells.type) or pa.types.is_large_string(cells.type):
            cells = pc.utf8_trim_whitespace(cells)
            blank = np.asarray(pc.fill_null(pc.equal(cells, ""), True))
            values = self._parsed(column, pc.if_else(pc.equal(cells, ""), None, cells))
        else:
            blank = np.asarray(pc.is_null(cells))
            values = np.asarray(cells.cast(pa.float64()).fill_null(0.0))
        refuse(self, ~np.isfinite(values) & ~blank, f"{column} is not finite", "give a number")
        what = f"{column} is larger than {largest:g}"
        refuse(self, (np.abs(values) > largest) & ~blank, what, "correct the number, or leave it empty")
        if empty is None:
            refuse(self, blank, f"{column} is empty", "give a number")
            return np.array(values)
        return np.where(blank, empty, values)

    def matrix(self, columns: Iterable[str], *, empty: float | None = None) -> Floats:
        """Numbers of several columns side by side, shape (n, columns)."""
        return np.column_stack([self.numbers(column, empty=empty) for column in columns])

    def _parsed(self, column: str, cells: Any) -> Floats:
        if self.separator != "," and pc.any(pc.match_substring(cells, ",")).as_py():
            cells = self._with_points(column, cells)
        try:
            return np.asarray(cells.cast(pa.float64()).fill_null(0.0))
        except pa.ArrowInvalid:
            pass
        for row, cell in enumerate(cells.to_pylist()):
            try:
                float((cell or "0").replace("_", "x"))
            except ValueError:
                comma = re.fullmatch(_COMMA, cell) is not None
                raise InputMalformedError(
                    f"{column} is {cell!r}, " + ("with a decimal comma" if comma else "not a number"),
                    "write a decimal point, or separate the cells by semicolons"
                    if comma
                    else "write numbers with a decimal point and without unit",
                    where=self.place(row),
                ) from None
        # Spellings that only one of the two readers takes, such as "+1.5".
        return np.array([float(cell or 0) for cell in cells.to_pylist()])

    def _with_points(self, column: str, cells: Any) -> Any:
        """Cells of a column with decimal commas; a point stands before groups of three digits only."""
        for row, cell in enumerate(cells.to_pylist()):
            if cell and not re.fullmatch(_COMMA, cell):
                raise InputMalformedError(
                    f"{column} is {cell!r} where other rows have decimal commas",
                    "write all numbers in one way",
                    where=self.place(row),
                )
        return pc.replace_substring(pc.replace_substring(cells, ".", ""), ",", ".")


def read_table(path: Path, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> TextTable:
    """Read a table of CSV or Parquet.

    required, optional: names of the columns; no others are allowed.
    raises InputNotFoundError: when there is no such file, or it is empty.
    raises InputMalformedError: when it cannot be read as a table, is cut, or has other columns.
    """
    table = read_wider_table(path, required)
    for name in table.columns.column_names:
        if name not in required + optional:
            raise InputMalformedError(
                f"column {name} is not known", f"allowed are {', '.join(required + optional)}", where=path
            )
    return table


def read_wider_table(path: Path, required: tuple[str, ...]) -> TextTable:
    """Read a table that may have any further columns; errors as of `read_table`."""
    table = read_columns(path)
    columns = list(table.columns.column_names)
    malformed = InputMalformedError.at(path)
    for name in required:
        if name not in columns:
            raise malformed(
                f"column {name} is missing (found {', '.join(columns)})",
                f"the header must have {', '.join(required)}",
            )
    for name in columns:
        if columns.count(name) > 1:
            raise malformed(f"column {name} comes twice", "give each column its own name")
    return table


def read_under(path: Path, heads: Mapping[str, Sequence[str]], required: Iterable[str]) -> TextTable:
    """Read a table whose columns people name in other ways; those without a name of ours are left out.

    heads: words for each column, the first of them that stands there counts; case, accents, signs, units and
        words that say only that a column has coordinates do not.
    """
    table = read_columns(path)
    given = table.columns.column_names
    known = {folded(word) for words in heads.values() for word in words}
    whole = [_headed(name, known) for name in given]
    short = [shortened(name) for name in whole]
    place = {}
    for key, words in heads.items():
        for word in map(folded, words[::-1]):
            if word in whole or word in short:
                place[key] = whole.index(word) if word in whole else short.index(word)
    if missing := [key for key in required if key not in place]:
        names = [name.lower().strip() for name in given]
        raise InputNotFoundError(f"has no column {missing[0]} (found {', '.join(names)})", where=path)
    columns = table.columns.select(list(place.values())).rename_columns(list(place))
    return replace(table, columns=columns, heads={key: given[k] for key, k in place.items()})


def _headed(name: str, known: Container[str]) -> str:
    """A folded head; of an axis that has the direction in brackets, as in "X (north)", this direction."""
    axis = re.fullmatch(r"\s*[XYxy]\s*[(\[]\s*(\w{4,})\s*[)\]]\s*", name)
    return folded(axis[1]) if axis and folded(axis[1]) in known else folded(name)


def folded(head: str) -> str:
    """A head as it is compared: small letters without accents, blanks for signs, no unit in brackets."""
    outside = re.sub(r"[(\[].*", "", head) if re.match(r"[^(\[]*\w", head) else head
    letters = unicodedata.normalize("NFKD", outside.casefold().replace("º", "").replace("°", ""))
    plain = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return " ".join(re.split(r"[\W_]+", plain)).strip()


def shortened(head: str) -> str:
    """A folded head without words of its unit, or that it has coordinates."""
    words = head.split()
    return " ".join([word for word in words if word not in _NO_HEADS] or words)


def read_columns(path: Path) -> TextTable:
    """Read a table whatever its columns are called; errors as of `read_table`."""
    require_file(file_of(path))
    if file_of(path).suffix.lower() in SUFFIXES:
        columns, above = read_layer(path)
        # Cells are apart without commas.
        table = TextTable(path, columns, lines=False, separator="", titles=above)
    else:
        table = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    if not len(table):
        raise InputMalformedError("has no rows", "was it written completely?", where=path)
    return table


def require_file(path: Path) -> int:
    """Refuse a path that is not a file with content; returns its size, bytes."""
    try:
        is_folder, size = path.is_dir(), path.stat().st_size
    except (OSError, ValueError) as failure:
        # Also a name from another file that is longer than names can be.
        raise InputNotFoundError("does not exist", "check the path", where=path) from failure
    if is_folder:
        raise InputNotFoundError("is a folder, a file was expected", "name the file", where=path)
    if size == 0:
        raise InputNotFoundError("is empty", "was it written completely?", where=path)
    return size


def _read_parquet(path: Path) -> TextTable:
    try:
        return TextTable(path, pyarrow.parquet.read_table(path), lines=False)
    except (pa.ArrowInvalid, OSError) as failure:
        raise InputMalformedError(
            f"is not a readable Parquet file ({str(failure).splitlines()[0]})", "write it again", where=path
        ) from failure


def _read_csv(path: Path) -> TextTable:
    encoding, titles, header = _head(path)
    separator = max(",;\t", key=header.count)
    names = [name.strip().strip('"') for name in header.split(separator)]
    texts = pyarrow.csv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
    )
    try:
        columns = pyarrow.csv.read_csv(
            path,
            read_options=pyarrow.csv.ReadOptions(
                use_threads=False, encoding=encoding, column_names=names, skip_rows=titles + 1
            ),
            parse_options=pyarrow.csv.ParseOptions(delimiter=separator, newlines_in_values=True),
            convert_options=texts,
        )
    except (pa.ArrowInvalid, UnicodeError) as failure:
        raise _cut(path, str(failure)) from failure
    table = TextTable(path, columns, lines=True, separator=separator, titles=titles)
    _refuse_cut_end(table)
    return table


def _head(path: Path) -> tuple[str, int, str]:
    """Encoding of a text, by its mark or its first million bytes, titles before its heads, and these."""
    with path.open("rb") as text:
        start = text.read(_HEAD_BYTES)
    encoding = next((name for mark, name in MARKS if start.startswith(mark)), "utf-8")
    try:
        # A character may be cut at the end of what was read.
        head = codecs.getincrementaldecoder(encoding)().decode(start)
    except UnicodeDecodeError:
        encoding = windows_encoding(start)
        head = start.decode(encoding, "replace")
    lines = head.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")[:_TITLES]
    cells = [sum(bool(cell.strip()) for cell in re.split("[,;\t]", line)) for line in lines]
    titles = next((k for k, count in enumerate(cells) if count > 1), 0)
    # A point and its place are four cells.
    fewest = 4
    titles = titles if cells[titles] >= fewest else 0
    return encoding, titles, lines[titles]


def windows_encoding(content: bytes) -> str:
    """Code page of a text that is no UTF-8: the western one, or that of Polish letters between others."""
    # What they are in the western one, superscripts and signs of money, stands in no word.
    return "cp1250" if re.search(rb"[a-z\xf3][\xb3\xb9\xbf][a-z]|\x9c\xe6", content.lower()) else "cp1252"


def _cut(path: Path, message: str) -> InputMalformedError:
    """Say what the reader found wrong with the rows."""
    match = re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+)", message)
    if match:
        row, expected, got = match.groups()
        return InputMalformedError(
            f"has {got} cells where the header has {expected}",
            "are these decimal commas? If so, separate the cells by semicolons"
            if int(got) > int(expected)
            else "complete the row, or is the table truncated?",
            where=f"{path}, row {row}",
        )
    return InputMalformedError(
        f"is not a readable table ({message.splitlines()[0]})", "write it as UTF-8 text", where=path
    )


def _refuse_cut_end(table: TextTable) -> None:
    """Refuse a table that seems truncated inside its last cell."""
    # Without a final line end the last number may have lost digits. That is taken for granted when it has
    # fewer decimals, or fewer digits, than every other number of its column, or ends where no number ends.
    with table.path.open("rb") as text:
        text.seek(-min(2, table.path.stat().st_size), 2)
        if text.read(2).rstrip(b"\0")[-1:] in b"\r\n":
            return
    cells = [str(cell).strip() for cell in table.columns.columns[-1].to_pylist()]
    if not cells or not re.fullmatch(r"[-+0-9.eE]+", cells[-1]):
        return
    filled = [cell for cell in cells if cell]
    shorter = [
        len(filled) > 1 and length[-1] < min(length[:-1])
        for length in ([len(cell.partition(".")[2]) for cell in filled], [len(cell) for cell in filled])
    ]
    if cells[-1][-1] in ".eE+-" or any(shorter):
        raise InputMalformedError(
            "seems truncated inside its last cell (no line end, fewer digits than in all other rows)",
            "end the last line with a line end if it is complete",
            where=table.place(len(table) - 1),
        )


def known_rows(table: TextTable, column: str, known: tuple[str, ...], where: str) -> Integers:
    """Index of each row's name among the known ones; complains of the first row with another."""
    index, names = table.names(column)
    position = {name: k for k, name in enumerate(known)}
    row = np.array([position.get(name, -1) for name in names], dtype=np.int64)[index]
    for k in np.flatnonzero(row < 0)[:1].tolist():
        what = f"{column} {names[index[k]]!r} is not in {where}"
        raise InputMalformedError(what, "correct the name", where=table.place(k))
    return row


def refuse(table: TextTable, bad: ArrayLike, what: str, remedy: str) -> None:
    """Complain of the first bad row."""
    rows = np.flatnonzero(bad)
    if len(rows):
        raise InputMalformedError(what, remedy, where=table.place(int(rows[0])))


def named_columns(names: str, values: Floats) -> dict[str, ArrayLike]:
    """Name the columns of an array, shape (n, columns), by words."""
    return dict(zip(names.split(), values.T, strict=True))


def name_cells(column: str, names: Sequence[str]) -> Any:
    """Names as cells of a column.

    raises OutputError: for a name that a table would not give back as it is.
    """
    cells = pa.array(names, pa.string())
    lost = pc.or_(pc.equal(cells, ""), pc.not_equal(pc.utf8_trim_whitespace(cells), cells))
    if pc.any(lost).as_py():
        bad = names[pc.index(lost, True).as_py()]
        raise OutputError(
            f"{column} {bad!r} is empty, or begins or ends with a blank, which tables do not keep",
            "give it another name",
        )
    return cells


def write_table(path: Path, columns: Mapping[str, Any] | Any) -> None:
    """Write an Arrow table, or columns by their names, as CSV or Parquet: numbers with all their digits.

    What is no finite number (NaN: not known, infinity: free) is an empty cell.
    """
    if isinstance(columns, Mapping):
        columns = pa.table({name: _cells(column) for name, column in columns.items()})
    if path.suffix == ".parquet":
        pyarrow.parquet.write_table(columns, path)
        return
    with path.open("wb") as stream:
        stream.write((",".join(columns.column_names) + "\n").encode())
        # "needed" puts every text in quotes, needed or not.
        texts = [cells for cells in columns.columns if pa.types.is_string(cells.type)]
        quotes = any(pc.any(pc.match_substring_regex(cells, '[",\r\n]')).as_py() for cells in texts)
        style = "needed" if quotes else "none"
        options = pyarrow.csv.WriteOptions(include_header=False, quoting_style=style)
        pyarrow.csv.write_csv(columns, stream, options)


def _cells(column: Any) -> Any:
    if isinstance(column, np.ndarray) and column.dtype.kind == "f":
        return pa.array(np.where(np.isfinite(column), column, np.nan), from_pandas=True)
    return pa.array(column, pa.string()) if isinstance(column, list | tuple) else column
