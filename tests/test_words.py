"""One word for one thing: the code has none of the words that ``docs/glossary.md`` replaces."""

import io
import re
import tokenize

import pytest

from tests.test_docs import OLD_WORDS, REPOSITORY

FILES = [
    file
    for folder in ("feasigrasp", "feasigrasp_lab", "diagrams", "examples", "tools")
    for file in sorted((REPOSITORY / folder).rglob("*.py"))
]
#: Parts of identifiers that the glossary replaces, and verbs of persons.
OLD_NAMES = re.compile(
    r"(strands?|prices?|priced|outlook|lookout|sought|funnel|astray|anyhow|unsure|rehears\w*|surer"
    r"|likelier|likeliest|certainty|twins?|company|companions?|befalls?|blows?|struck|followable"
    r"|told|tells?|heard|hears?|knows|believed?|believes|belief|nobody|said|unseen)",
    re.IGNORECASE,
)
#: Identifiers with such a part that others rely on: names of commands, rows and stored weights.
NAMES = {
    "said": "feasigrasp_lab/baselines/diffusion_energy.py",  # a layer, by this name in the weights
}
#: Sentences in which such a word has its ordinary meaning.
SENTENCES = re.compile(r"feasigrasp fit certainty|feasigrasp-evaluate-\w+|--blows|so far as")


def tokens(text: str) -> list[tokenize.TokenInfo]:
    return list(tokenize.generate_tokens(io.StringIO(text).readline))


def old_names(text: str) -> set[str]:
    """Identifiers with a part that the glossary replaces."""
    names = {token.string for token in tokens(text) if token.type == tokenize.NAME}
    parts = {name: re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name) for name in names}
    return {name for name in names if any(OLD_NAMES.fullmatch(part) for part in parts[name])}


def old_words(text: str) -> list[str]:
    """Words that the glossary replaces, in comments, docstrings and messages of several words."""
    found = []
    for token in tokens(text):
        sentence = token.type == tokenize.STRING and " " in token.string
        if sentence or token.type == tokenize.COMMENT:
            plain = SENTENCES.sub("", re.sub(r"``.*?``|`[^`\n]*`", "", token.string))
            found += [match[0] for match in OLD_WORDS.finditer(plain)]
    return found


def test_the_code_uses_the_words_of_the_glossary():
    found = {}
    for file in FILES:
        text, path = file.read_text(), file.relative_to(REPOSITORY).as_posix()
        names = {name for name in old_names(text) if NAMES.get(name) != path}
        if names or old_words(text):
            found[path] = sorted(names) + old_words(text)
    assert not found


@pytest.mark.parametrize(
    ("find", "text"),
    [
        (old_names, "best_strand = 1"),
        (old_names, "class RobotTwin: ..."),
        (old_words, "# the filter knows its motion"),
        (old_words, 'raise ValueError("the pose is believed")'),
    ],
)
def test_the_checks_can_fail(find, text):
    assert find(text)
    assert not find(
        'candidate = "known"  # a candidate of the `strand` of `feasigrasp fit certainty`'
    )
