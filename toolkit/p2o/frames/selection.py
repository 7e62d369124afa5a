"""Select frames of a dataset by indices (`0,3,5-9`, `10:20:2`), names, or a split of a JSON file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded, read_text
from p2o.files.parsed_text import parse_json

# The number of digits is limited, because Python refuses to convert thousands of them.
_INDEX = re.compile(r"-?\d{1,18}")
_RANGE = re.compile(r"(\d{1,18})-(\d{1,18})")
_SLICE = re.compile(r"(-?\d{1,18})?:(-?\d{1,18})?(?::(-?\d{1,18})?)?")
_SYNTAX = (
    "all, indices (0,3,-1), ranges (5-9, ends included), slices (10:20:2), names, wildcards (*_0005*), or "
    "@splits.json#SPLIT"
)


def select(
    names: Sequence[str], spec: str, where: object = None, skipped: Mapping[str, str] | None = None
) -> list[int]:
    """Return the indices of the selected frames, in the order of `spec`, without duplicates.

    `spec` is a list, separated by commas, of `all`; an index, negative from the end; a range `5-9` with both ends; a
    Python slice `10:20:2`; a name or the unique end of one after a `/`; wildcards `*`, `?` and `[seq]` (`fnmatch`) for
    names or their ends; `@FILE.json#SPLIT`, a list of names in a JSON file (`#SPLIT` is optional if the file is a list
    or has one split). Names have priority over indices, and numbers
    with a leading zero are names. `where` is the place in errors; `skipped` maps names of frames that the dataset left
    out to the reason. Raises UnknownNameError for an unknown frame or split, InputError for indices out of range, wrong
    syntax, an ambiguous name, a JSON file that is missing or invalid, and split entries that the dataset lacks.
    """
    index_of = {name: index for index, name in enumerate(names)}
    chosen: dict[int, None] = {}
    for word in (part.strip() for part in spec.split(",")):
        chosen.update(dict.fromkeys(_chosen(names, index_of, word, where, skipped or {})))
    if not chosen:
        raise InputError("no frame is selected", where=where, expected=_SYNTAX, got=f"'{spec}' of {len(names)} frames")
    return list(chosen)


def spread(indices: Sequence[int], most: int) -> list[int]:
    """Return at most `most` of the indices, evenly spaced from the first to the last."""
    if len(indices) <= most:
        return list(indices)
    if most == 1:
        return [indices[0]]
    return [indices[round(place * (len(indices) - 1) / (most - 1))] for place in range(most)]


def _chosen(
    names: Sequence[str], index_of: Mapping[str, int], word: str, where: object, skipped: Mapping[str, str]
) -> Sequence[int]:
    if word in index_of:
        return [index_of[word]]
    if not word:
        raise InputError("an empty word in the selection of frames", where=where, expected=_SYNTAX)
    if word == "all":
        return range(len(names))
    if word.startswith("@"):
        return _split(index_of, word[1:], where)
    leading_zero = re.search(r"(?<!\d)0\d", word) is not None
    if _INDEX.fullmatch(word) and not leading_zero:
        return [_checked(int(word), names, where)]
    if (match := _RANGE.fullmatch(word)) and not leading_zero:
        first, last = (_checked(int(end), names, where) for end in match.groups())
        if last < first:
            text = f"the range '{word}' runs backwards"
            raise InputError(text, where=where, expected=f"{last}-{first}", got=f"'{word}'")
        return range(first, last + 1)
    if match := _SLICE.fullmatch(word):
        start, stop, step = (int(part) if part else None for part in match.groups())
        if step == 0:
            raise InputError(f"the slice '{word}' has step 0", where=where, expected=_SYNTAX)
        return range(len(names))[slice(start, stop, step)]
    return _named(names, word, where, skipped)


def _checked(index: int, names: Sequence[str], where: object) -> int:
    if not -len(names) <= index < len(names):
        expected = f"0 to {len(names) - 1}" if names else "a dataset with frames"
        raise InputError(f"frame index {index} is out of range", where=where, expected=expected)
    return index % len(names)


def _named(names: Sequence[str], word: str, where: object, skipped: Mapping[str, str]) -> Sequence[int]:
    tails = [index for index, name in enumerate(names) if name.endswith(f"/{word}")]
    if len(tails) == 1:
        return tails
    if not tails and (matching := [index for index, name in enumerate(names) if _matches(name, word)]):
        return matching
    if tails:
        got = " or ".join(names[index] for index in tails[:3])
        raise InputError(f"'{word}' is the end of {len(tails)} names", where=where, expected="a name", got=got)
    for name, reason in skipped.items():
        if _matches(name, word):
            raise InputError(f"frame '{name}' is left out of the dataset", where=where, got=reason)
    letters = re.sub(r"[*?\[\]]", "", word)
    hint = f"frames are selected by {_SYNTAX}"
    if letters != word:
        near = difflib.get_close_matches(letters[:200], names[:5000], n=3, cutoff=0.0)
        raise InputError(f"no frame matches '{word}'", where=where, expected=f"nearest {', '.join(near)}", hint=hint)
    raise UnknownNameError("frame", word, names, where=where, hint=hint)


def _matches(name: str, word: str) -> bool:
    """Return whether a word, in which wildcards are allowed, is a name or its end after a `/`."""
    return name == word or name.endswith(f"/{word}") or fnmatchcase(name, word) or fnmatchcase(name, f"*/{word}")


def _split(index_of: Mapping[str, int], word: str, where: object) -> list[int]:
    file, hash_sign, split = word.partition("#")
    path = expanded(file)
    splits = _read_splits(path)
    if not hash_sign:
        if len(splits) != 1:
            raise InputError(
                "the file has several splits", where=path, expected=f"@{file}#SPLIT with one of: {', '.join(splits)}"
            )
        split = next(iter(splits))
    if split not in splits:
        raise UnknownNameError("split", split, splits, where=path)
    entries = splits[split]
    absent = [name for name in entries if name not in index_of]
    if absent:
        text = f"{len(absent)} of the {len(entries)} frames of split '{split}' are not in the dataset"
        expected = f"names such as {next(iter(index_of))}" if index_of else "a dataset with frames"
        hint = None if where is None else f"requested by {where}"
        raise InputError(text, where=path, expected=expected, got=absent[0], hint=hint)
    return [index_of[name] for name in entries]


def _read_splits(path: Path) -> Mapping[str, list[str]]:
    """Return the lists of names of a JSON file by split; a bare list is a split with an empty name."""
    content = parse_json(read_text(path, "file of splits"), "file of splits", path)
    splits = {"": content} if isinstance(content, list) else content
    lists = splits.values() if isinstance(splits, dict) else [None]
    if not all(isinstance(entries, list) and all(isinstance(name, str) for name in entries) for entries in lists):
        raise InputError("the file of splits has another form", where=path, expected='{"SPLIT": ["NAME", ...], ...}')
    return splits
