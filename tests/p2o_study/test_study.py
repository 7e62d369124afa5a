"""A study file says what to run; whatever is wrong with it is told before any work."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import pytest
from p2o import InputError, Registry, UnknownNameError
from p2o.run.presets import presets
from p2o_study.study import ALL_JOINT, check_study, find_study, parse_study, shipped_toml

PLUGIN = Path(__file__).parents[1] / "study_plugin.py"
HEAD = 'name = "s"\ntitle = "S"\n[[dataset]]\nname = "tiny"\ndata = "tiny:"\n'
ROW = '[[row]]\nlabel = "a"\n'
TINY = '[defaults]\nextractor = "tiny/tiny"\n'
SIDES = '[[variant]]\nname = "ogm-lr"\nmatcher = "ogm"\noptions.matcher.sides = "LR"\n'


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry.load(extra_files=[PLUGIN], environ={})


def test_a_product_combines_its_lists_and_a_variant_stands_for_a_method_with_options(registry: Registry) -> None:
    text = HEAD + TINY + SIDES + '[[product]]\nmatcher = ["ogm", "ogm-lr"]\nsolver = ["lm", "scipy"]\n'
    rows = check_study(parse_study(text), registry)
    assert [row.label for row in rows] == ["ogm lm", "ogm scipy", "ogm-lr lm", "ogm-lr scipy"]
    assert [row.words["matcher"] for row in rows] == ["ogm"] * 4
    assert [row.words["options"] for row in rows] == [
        {},
        {},
        {"matcher": {"sides": "LR"}},
        {"matcher": {"sides": "LR"}},
    ]
    assert rows[3].resolve(registry, 0).parts["matcher"].options.sides == "LR"


def test_rows_follow_products_and_say_their_own_start_seeds_and_joining(registry: Registry) -> None:
    text = (
        'perturb = "2deg 0.15m"\nseeds = 3\n'
        + HEAD
        + TINY
        + '[[product]]\nlabel = "{init}!"\ninit = ["given", "search"]\nseeds = [4, 7]\n'
        + ROW
        + 'joint = true\nperturb = "uniform 3deg 0.15m"\n[[row]]\nlabel = "b"\njoint = 5\n'
    )
    rows = check_study(parse_study(text), registry)
    assert [(row.label, row.seeds, row.joint, row.words["perturb"]) for row in rows] == [
        ("given!", (4, 7), 0, "2deg 0.15m"),
        ("search!", (4, 7), 0, "2deg 0.15m"),
        ("a", (0, 1, 2), ALL_JOINT, "uniform 3deg 0.15m"),
        ("b", (0, 1, 2), 5, "2deg 0.15m"),
    ]
    assert rows[2].recipe(1).joint
    assert not rows[3].recipe(1).joint


def test_options_of_a_default_are_left_behind_where_another_method_takes_its_place(registry: Registry) -> None:
    text = (
        HEAD
        + '[defaults]\nextractor = "tiny/tiny"\nmatcher = "ogm"\n[defaults.options]\nmatcher = { sides = "LR" }\n'
        + "cloud = { step = 0.5 }\npipeline = { rounds = 3 }\n"
        + ROW
        + '[[row]]\nlabel = "b"\nmatcher = "nearest"\nextractor = "tiny-plain/tiny"\n'
        + '[[row]]\nlabel = "c"\ncalibrator = "quick"\n'
    )
    first, second, third = check_study(parse_study(text), registry)
    assert first.words["options"]["matcher"] == {"sides": "LR"}
    assert second.words["options"] == {"cloud": {"step": 0.5}, "pipeline": {"rounds": 3}}
    assert third.words == {"calibrator": "quick", "options": {}}


def test_several_datasets_give_a_row_each(registry: Registry) -> None:
    text = HEAD + '[[dataset]]\nname = "more"\ndata = "tiny:?frames=5"\n' + TINY + ROW + '[[row]]\nlabel = "b"\n'
    rows = check_study(parse_study(text + 'dataset = ["more"]\n'), registry)
    assert [row.label for row in rows] == ["a @ tiny", "a @ more", "b @ more"]
    assert [row.dataset.name for row in rows] == ["tiny", "more", "more"]


def test_the_command_line_changes_data_frames_and_seeds() -> None:
    two = '[[dataset]]\nname = "more"\ndata = "tiny:"\n'
    study = parse_study(HEAD + two + ROW + "seeds = 9\n").overridden(["more=fake:x=1"], "0-3", 2)
    assert [(d.data, d.frames) for d in study.dataset] == [("tiny:", "0-3"), ("fake:x=1", "0-3")]
    assert study.rows()[0].seeds == (0, 1)
    assert parse_study(HEAD + ROW).overridden(["fake:a/b"]).dataset[0].data == "fake:a/b"
    with pytest.raises(InputError, match="NAME=DATASET:PATH with a NAME of tiny, more"):
        study.overridden(["fake:x"])
    with pytest.raises(UnknownNameError, match="did you mean more"):
        study.overridden(["mor=fake:x"])


OPTIONAL = '[[dataset]]\nname = "more"\ndata = "tiny:"\noptional = true\npath = "a/b"\nsplit = ["x", "y"]\n'


def test_a_dataset_that_may_be_missing_is_left_out_with_all_its_rows(tmp_path: Path) -> None:
    """Its labels and what is published beside its rows stay known, so that nothing else changes by it."""
    beside = '[[published]]\nlabel = "p"\nsource = "q"\nvalues = {}\nbeside = "b"\n'
    study = parse_study(HEAD + OPTIONAL + TINY + ROW + '[[row]]\nlabel = "b"\ndataset = ["more"]\n' + beside)
    assert [row.label for row in study.rows()] == ["a @ tiny"]
    assert [row.label for row in study.overridden(root=tmp_path).rows()] == ["a @ tiny"], "it is not there"
    (tmp_path / "a/b").mkdir(parents=True)
    for there in (study.overridden(root=tmp_path), study.overridden([f"more=tiny:{tmp_path}/a/b"])):
        assert [row.label for row in there.rows()] == ["a @ tiny", "a @ more", "b @ more"]
        assert there.dataset[1].data == f"tiny:{tmp_path}/a/b"
    said = study.overridden(["more=tiny:elsewhere"], root=tmp_path)
    assert said.dataset[1].data == "tiny:elsewhere", "--data goes before --root"


def test_frames_are_chosen_for_all_datasets_or_for_one(tmp_path: Path) -> None:
    study = parse_study(HEAD + OPTIONAL + ROW)
    for said, expected in (
        ("0-3", ("0-3", "0-3")),
        (["0-3", "more=5"], ("0-3", "5")),
        ("more=@s.json#z", ("all", "@s.json#z")),
        ("@s.json", ("@s.json", "@s.json#x,@s.json#y")),
        ("@s.json#z", ("@s.json#z", "@s.json#z")),
        ("@a=b.json#z", ("@a=b.json#z", "@a=b.json#z")),
    ):
        assert tuple(table.frames for table in study.overridden(frames=said).dataset) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('colour = "red"\n' + HEAD + ROW, r"unknown key 'colour'.*expected one of: dataset, defaults"),
        (HEAD + ROW + 'macher = "ogm"\n', r"\[\[row\]\] 1 'a': unknown key 'macher'.*did you mean matcher"),
        (HEAD + ROW + 'joint = "rigs"\n', r"\[\[row\]\] 1 'a': joint is not valid"),
        (HEAD + ROW + "joint = 1\n", r"\[\[row\]\] 1 'a': joint is not valid"),
        (HEAD + ROW + 'seeds = "many"\n', "seeds is not valid"),
        (HEAD + "[[row]]\n" + 'matcher = "ogm"\n', r"\[\[row\]\] 1: label is missing"),
        ('name = "s"\ntitle = "S"\n' + ROW, "dataset is missing"),
        (
            HEAD + ROW + '[[published]]\nlabel = "x"\nsource = "y"\nvalues = { speed = 3 }\n',
            "values.speed is not",
        ),
        ("name = x\n", "my.toml: the study is not TOML.*line 1"),
        ('name = "Table 2"\n' + HEAD[11:] + ROW, "name is not valid"),
    ],
)
def test_a_word_that_does_not_belong_is_named_with_its_place(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_study(text, "my.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, r"the study has no rows"),
        (HEAD + ROW + ROW, "the name 'a' of a row is used twice"),
        (HEAD + SIDES + SIDES + ROW, "the name 'ogm-lr' of a variant is used twice"),
        (HEAD + HEAD[22:] + ROW, "the name 'tiny' of a dataset is used twice"),
        (HEAD + ROW + 'use = ["ogm-rl"]\n' + SIDES, "unknown variant 'ogm-rl'.*did you mean ogm-lr"),
        (HEAD + SIDES + ROW + 'solver = "ogm-lr"\n', "variant 'ogm-lr' sets no solver"),
        (
            HEAD + SIDES + ROW + 'matcher = "nearest"\nuse = ["ogm-lr"]\n',
            "variant 'ogm-lr' and row 'a' both set matcher",
        ),
        (HEAD + SIDES + '[[variant]]\nname = "x"\nmatcher = "ogm-lr"\n' + ROW, "uses the variant 'ogm-lr'"),
        (HEAD + ROW + 'dataset = ["other"]\n', "unknown dataset 'other'"),
        (HEAD + ROW + "seeds = [1, 1]\n", "different seeds"),
        (HEAD + "[[product]]\nseeds = 3\n", "no lists to combine"),
        (HEAD + '[[product]]\nmatcher = ["ogm", "ogm"]\n', "the name 'ogm' of a matcher of a product is used twice"),
        (HEAD + '[[product]]\nlabel = "{mather}"\nmatcher = ["ogm"]\n', r"such as \{matcher\}"),
        (HEAD + ROW + '[[published]]\nlabel = "p"\nsource = "q"\nvalues = {}\nbeside = "b"\n', "unknown row 'b'"),
    ],
)
def test_names_that_clash_or_lead_nowhere_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_study(text).rows()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + ROW + 'matcher = "omg"\n', "row 'a': unknown matcher 'omg'.*did you mean ogm"),
        (HEAD + ROW + "options.matcher.sides = 3\n", "row 'a': matcher.sides"),
        (HEAD + ROW + 'options.macher = { sides = "LR" }\n', "unknown stage 'macher'"),
        (
            HEAD + ROW + 'extractor = "tiny-plain/tiny"\n',
            "row 'a': tiny-plain gives no side; ogm needs it; try --matcher",
        ),
        (HEAD + ROW + 'calibrator = "quick"\nsolver = "lm"\n', "row 'a': calibrator 'quick' is a whole method"),
        (HEAD + ROW + 'perturb = "2 degrees"\n', "cannot read the size"),
        (
            HEAD + '[[variant]]\nname = "nearest"\nmatcher = "ogm"\n' + ROW,
            "'nearest' has the name of an installed matcher",
        ),
        (HEAD.replace("tiny:", "kitty:") + ROW, "row 'a': unknown dataset 'kitty'.*did you mean"),
        (HEAD + '[[variant]]\nname = "x"\nperturb = "far"\n' + ROW, "cannot read the size"),
    ],
)
def test_what_cannot_be_run_is_refused_with_its_row_and_what_would_fit(
    text: str, message: str, registry: Registry
) -> None:
    with pytest.raises(InputError, match=message):
        check_study(parse_study(text), registry)


@pytest.mark.parametrize(
    "pattern",
    [
        "{matcher.__class__}", "{matcher[0]}", "{use:>99999999}", "{matcher!r}", "{matcher:{use}}", "{0}", "{}", "{",
        "{matcher}}", "{extractor}", "{__init__}",
    ],
)  # fmt: skip
def test_a_label_takes_names_alone(pattern: str) -> None:
    """Python's formats reach into objects, and write as wide as they are told."""
    text = HEAD + f'[[product]]\nlabel = "{pattern}"\nmatcher = ["ogm"]\n'
    with pytest.raises(InputError, match=r"cannot be filled in; expected names such as \{matcher\}"):
        parse_study(text).rows()


def test_a_label_may_hold_braces() -> None:
    text = HEAD + '[[product]]\nlabel = "{{{matcher}}} {use}"\nmatcher = ["ogm"]\n'
    assert [row.label for row in parse_study(text).rows()] == ["{ogm}"]


@pytest.mark.parametrize(
    "words",
    [
        "seeds = 10001", "seeds = 999999999999999999", f"seeds = [{'1, ' * 10001}]", "seeds = [4294967296]",
        "seeds = [-1]", "seeds = 0", "seeds = true", "seeds = 1.5",
    ],
)  # fmt: skip
def test_seeds_have_a_bound(words: str) -> None:
    for text in (HEAD + ROW + words + "\n", f"{words}\n" + HEAD + ROW):
        with pytest.raises(InputError, match="seeds"):
            parse_study(text).rows()
    assert parse_study(HEAD + ROW + "seeds = [4294967295]\n").rows()[0].seeds == (4294967295,)


MANY = ", ".join(f'"m{i}"' for i in range(100))
PRODUCT = "".join(f"{word} = [{MANY}]\n" for word in ("matcher", "solver", "init", "accumulate", "witness", "perturb"))


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "[[product]]\n" + PRODUCT,
        HEAD + "[[product]]\n" + PRODUCT + f"use = [{', '.join(['[]'] * 100)}]\nseeds = 10000\n",
        HEAD + "[[product]]\n" + f"matcher = [{MANY}]\nsolver = [{MANY}]\nseeds = 3\n",
        HEAD + "".join(f'[[row]]\nlabel = "r{i}"\nseeds = 10000\n' for i in range(3)),
        HEAD + "".join(f'[[row]]\nlabel = "r{i}"\n' for i in range(20_001)),
    ],
)
def test_more_rows_than_anyone_can_wait_for_are_refused_before_any_is_made(text: str) -> None:
    study = parse_study(text)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"study s: the study asks for .* rows times seeds; expected at most 2"):
            study.rows()
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("2020-01-01", "a text in quotes.*got 2020-01-01"),
        ("2020-01-01T10:00:00Z", "a text in quotes"),
        ("10:00:00", "a text in quotes"),
        ("nan", "a finite number"),
        ("-inf", "a finite number"),
        ("0x" + "f" * 200, "64 bits"),
        ("[[[2020-01-01]]]", "a text in quotes"),
    ],
)
@pytest.mark.parametrize("key", ["matcher", "options.matcher.sides", "seeds", "section"])
def test_values_of_toml_that_no_word_takes_are_told_with_their_place(value: str, message: str, key: str) -> None:
    with pytest.raises(InputError, match=rf"^my\.toml, row\.1\.{key}.*{message}"):
        parse_study(HEAD + ROW + f"{key} = {value}\n", "my.toml")
    with pytest.raises(InputError, match=message):
        parse_study(HEAD.replace("data = ", f"options = {{ x = {value} }}\ndata = ", 1) + ROW)


@pytest.mark.parametrize("letter", [r"\u001b[2J", r"\n", r"\u0000", r"\u202e", r"\u2028"])
@pytest.mark.parametrize("place", ["title", "label", "section", "source"])
def test_names_that_a_terminal_would_obey_are_refused(letter: str, place: str) -> None:
    text = 'name = "s"\ntitle = "title"\n' + HEAD[22:] + '[[row]]\nlabel = "label"\nsection = "section"\n'
    text += '[[published]]\nlabel = "x"\nsource = "source"\nvalues = {}\n'
    assert parse_study(text).rows()
    with pytest.raises(InputError, match="one line without control characters"):
        parse_study(text.replace(f'"{place}"', f'"a{letter}b"'))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_a_study_file_that_is_no_file_is_told(tmp_path: Path, registry: Registry) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    (tmp_path / "huge.toml").touch()
    os.truncate(tmp_path / "huge.toml", 1 << 40)
    for name, told in {"pipe": "a named pipe", "folder": "a folder", "latin": "not text", "huge": "too large"}.items():
        with pytest.raises(InputError, match=told):
            find_study(str(tmp_path / f"{name}.toml"), registry)


def test_studies_are_found_by_path_and_by_name(tmp_path: Path, registry: Registry) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(HEAD + ROW)
    found = find_study(str(file), registry)
    assert found.name == "s"
    assert find_study("table2", registry).name == "table2"
    with pytest.raises(UnknownNameError, match="did you mean table2"):
        find_study("tabel2", registry)
    with pytest.raises(InputError, match="the study file is missing"):
        find_study(str(tmp_path / "gone.toml"), registry)
    assert "table2" not in shipped_toml(Registry(), "studies"), "studies of plugins that are left out are not there"


def test_a_package_that_offers_plugins_ships_studies_without_a_hook(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "acme_p2o"
    (package / "studies").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "hooks.py").write_text("")
    (package / "studies" / "table2.toml").write_text(HEAD + ROW)
    (package / "studies" / "acme.toml").write_text(HEAD + ROW)
    info = tmp_path / "acme_p2o-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-p2o\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[p2o]\nacme = acme_p2o.hooks\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    registry = Registry.load(environ={})
    assert find_study("acme", registry).name == "s"
    with pytest.raises(UnknownNameError, match=r"unknown study 'table2'.*table2@acme-p2o"):
        find_study("table2", registry)
    assert find_study("table2@acme-p2o", registry).name == "s"
    assert "acme" not in shipped_toml(Registry.load(block=["acme-p2o"], environ={}), "studies")


@pytest.mark.parametrize("name", ["table2", "boxplot", "convergence", "smoke"])
def test_every_study_that_is_shipped_can_be_run(name: str, registry: Registry) -> None:
    study = find_study(name, registry)
    assert study.name == name
    rows = check_study(study.overridden([] if name == "smoke" else ["kitti-raw:somewhere"]), registry)
    assert len(rows) >= 2
    if name == "table2":
        published = {p.label: p.values for p in study.published}
        assert published["RGGNet"] == {"rotation_deg": 1.180, "translation_m": 0.088}
        assert published["line-based"] == {"rotation_deg": 0.388}
        assert {p.beside for p in study.published} >= {"w/o OGM", "w/o UB", "ours", "MBS"}


def test_a_row_names_a_published_method_and_changes_some_of_its_words_and_options() -> None:
    registry = Registry.load(environ={})
    head = 'name = "s"\ntitle = "S"\n[[dataset]]\nname = "d"\ndata = "synthetic:"\n'
    text = head + '[[variant]]\nname = "koide"\nmethod = "nid"\noptions.matcher.bins = 8\n'
    text += '[[row]]\nlabel = "a"\nuse = ["koide"]\n[[row]]\nlabel = "b"\nmethod = "nid"\nsolver = "nelder-mead"\n'
    changed, other = check_study(parse_study(text), registry)
    nid = presets(registry)["nid"]
    assert changed.words["matcher"] == "nid"
    assert changed.words["options"]["matcher"] == {"bins": 8}
    assert changed.words["options"]["solver"] == nid.options["solver"]
    assert other.words["solver"] == "nelder-mead"
    assert "solver" not in other.words["options"], "another solver does not have them"
    with pytest.raises(UnknownNameError, match=r"unknown method 'nyd'.*did you mean nid"):
        check_study(parse_study(text.replace('method = "nid"', 'method = "nyd"', 1)), registry)
