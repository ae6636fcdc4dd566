# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of every sentence that the program says."""

import ast
import re

import pytest

from trackres_ros.effects.registry import catalogue
from trackres_ros.estimator.columns import REASON_TEXT
from trackres_ros.learning.gate import TEXTS
from trackres_ros.node.notices import KINDS
from trackres_ros.recording.roles import ROLES

MOST_WORDS = 25
MARKUP = re.compile(r"</?\w+[ >]|\bSELECT\b")


def words(sentence):
    return [word for word in sentence.split() if re.search(r"\w", word)]


def text_of(node):
    """The text of a string or f-string, with one word for each value that is put in; None of anything else."""
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "X" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def texts_in(tree):
    """Texts of a module, without docstrings."""
    owners = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    nodes = list(ast.walk(tree))
    skipped = {id(node.body[0].value) for node in nodes if isinstance(node, owners) and ast.get_docstring(node, clean=False)}
    skipped |= {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    return [text for node in nodes if id(node) not in skipped and (text := text_of(node))]


@pytest.mark.parametrize(
    "texts",
    [
        REASON_TEXT.values(),
        [kind.meaning for kind in KINDS.values()],
        TEXTS,
        [effect.text for effect in catalogue().values()],
        [role.text for role in ROLES.values()],
    ],
    ids=["reasons", "notices", "learning", "effects", "roles"],
)
def test_no_status_or_note_is_longer_than_25_words(texts):
    assert not [text for text in texts if not text or len(words(text)) > MOST_WORDS]


def test_no_sentence_of_the_program_is_longer_than_25_words(repository):
    """Parts of a sentence that semicolons divide count as sentences."""
    long = [
        (path.name, sentence)
        for path in (repository / "trackres_ros").rglob("*.py")
        if "export" not in path.parts
        for text in texts_in(ast.parse(path.read_text(encoding="utf-8")))
        if not MARKUP.search(text)
        for sentence in re.split(r"(?<=[.!?;])\s|\n\n", text)
        if len(words(sentence)) > MOST_WORDS
    ]
    assert not long
