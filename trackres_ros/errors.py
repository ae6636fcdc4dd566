# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines `InputError`: unusable input, with a remedy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

MOST_SHOWN, MOST_OF_TEXT = 80, 200  # characters of the given value: of data, and of a text, which may be a sentence of ours
MOST_OF_PART = 1000  # characters of each other part
SHORT_NUMBER_BITS = 200
DISTRIBUTIONS = {"can": "python-can", "sklearn": "scikit-learn"}
"""What pip installs for a module, where the two have different names."""


class InputError(ValueError):
    """Invalid input from outside: a file, an option, a topic.

    Its text is one line with a remedy, however long the given value is.

    Parameters
    ----------
    where
        Place of the error: file and key, option or argument.
    given
        The given value.
    allowed
        The allowed values.
    remedy
        What to do, if that does not follow from the allowed values.
    """

    def __init__(self, where: str, given: object, allowed: str, remedy: str = "") -> None:
        self.where, self.given, self.allowed, self.remedy = where, given, allowed, remedy
        text = f"{one_line(where)}: given {shown(given)}; allowed: {one_line(allowed)}"
        super().__init__(f"{text}; {one_line(remedy)}" if remedy else text)

    def as_dict(self) -> dict[str, str]:
        """The parts of the text by name, for programs.

        Returns
        -------
        dict of str to str
            ``where``, ``given``, ``allowed`` and ``remedy``.
        """
        return {"where": self.where, "given": str(self.given), "allowed": self.allowed, "remedy": self.remedy}

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild the error in another process."""
        return type(self).__new__, (type(self), *self.args), self.__dict__  # of a kind whose own arguments may be other ones


class MissingExtraError(InputError):
    """An optional library is needed and not installed.

    Parameters
    ----------
    feature
        What needs it.
    module
        The Python module that is missing.
    extra
        The extra of this package that installs it.
    remark
        More to say of the installation.
    """

    def __init__(self, feature: str, module: str, extra: str, remark: str = "") -> None:
        distribution = DISTRIBUTIONS.get(module, module)
        super().__init__(
            feature,
            f"no Python module {module}",
            f"an installed {module}",
            f"install it with: pip install {distribution} (or this package with its extra [{extra}]){remark and f'; {remark}'}",
        )


def shown(value: object) -> str:
    """The given value as one short line: no more of it is read than is shown, so it may be huge or recursive."""
    limit = MOST_OF_TEXT if isinstance(value, str) else MOST_SHOWN
    text = ""
    for piece in _pieces(value):
        text += piece
        if len(text) > limit:
            return f"{text[: limit - 3]}..."
    return text


def _pieces(data: object) -> Iterator[str]:
    """`repr`, piece by piece."""
    if isinstance(data, str | bytes):
        yield repr(data[: MOST_OF_TEXT + 1])
    elif isinstance(data, int) and data.bit_length() > SHORT_NUMBER_BITS:  # thousands of digits cannot be written at all
        yield f"a whole number of {data.bit_length()} bits"
    elif isinstance(data, Mapping):
        yield from _collection("{", ((key, value) for key, value in data.items()), "}")
    elif isinstance(data, list):
        yield from _collection("[", ((value,) for value in data), "]")
    elif isinstance(data, tuple):
        yield from _collection("(", ((value,) for value in data), ",)" if len(data) == 1 else ")")
    elif isinstance(data, set | frozenset):
        yield from _collection("{", ((value,) for value in data), "}")
    else:
        yield one_line(repr(data))


def _collection(opening: str, parts: Iterable[tuple[object, ...]], closing: str) -> Iterator[str]:
    """A collection; a part is a value, or a key and its value."""
    yield opening
    for i, part in enumerate(parts):
        yield ", " if i else ""
        for j, value in enumerate(part):
            yield ": " if j else ""
            yield from _pieces(value)
    yield closing


def one_line(text: str) -> str:
    """A text on one line for any terminal: unprintable characters are escaped, a long text is cut."""
    cut = text if len(text) <= MOST_OF_PART else f"{text[: MOST_OF_PART - 3]}..."
    return cut if cut.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in cut)


def encodable(name: str) -> str:
    """A name that all programs can write: bytes that are not UTF-8 are escaped."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def nearest(word: str, names: Iterable[str]) -> str:
    """Return ``did you mean X?`` for the nearest of some names, or nothing."""
    import difflib  # only for an error: it takes as long to import as all else here

    close = difflib.get_close_matches(word, list(names), 1)
    return f"did you mean {close[0]}?" if close else ""
