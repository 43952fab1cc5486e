"""One name per concept: the glossary is current, its terms stand in the code, and words that are gone do not come back."""

import ast
import importlib.util
import re
import subprocess

import pytest

SUFFIXES = (".py", ".md", ".toml", ".yaml", ".js", ".css", "Makefile")
OWN = ("docs/words.py", "docs/glossary.md", "tests/conventions/test_words.py")


@pytest.fixture(scope="module")
def words(repository):
    spec = importlib.util.spec_from_file_location("docs_words", repository / "docs" / "words.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def texts(repository):
    """Every text of the project by path, lower case: what git knows, where this is a work tree."""
    listed = subprocess.run(["git", "ls-files"], cwd=repository, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a work tree: which files are the project's is not known")
    names = [n for n in listed.stdout.split() if n.endswith(SUFFIXES) and n not in OWN and (repository / n).is_file()]
    return {name: (repository / name).read_text(encoding="utf-8").lower() for name in names}


def found(pattern: str, texts: dict[str, str]) -> dict[str, int]:
    """How often a word stands in each file, its name included; letters on neither side."""
    whole = re.compile(rf"(?<![a-z])(?:{pattern})(?![a-z])")
    counts = {name: len(whole.findall(f"{name}\n{text}")) for name, text in texts.items()}
    return {name: n for name, n in counts.items() if n}


def test_words_that_are_gone_do_not_come_back(words, texts):
    more = {}
    any_of_them = found("|".join(words.GONE), texts)  # one pass over what has none
    some = {name: texts[name] for name in any_of_them}
    for pattern, say in words.GONE.items():
        allowed = words.STILL.get(pattern, {})
        for name, n in found(pattern, some).items():
            if n > allowed.get(name, 0):
                more[f"{name}: {pattern}"] = f"{n} times, {allowed.get(name, 0)} allowed; say: {say}"
    assert not more


def test_what_is_still_allowed_is_still_there(words, texts):
    over = [f"{n}: {p}" for p, files in words.STILL.items() for n in files if n not in found(p, texts)]
    assert not over, "take these out of STILL in docs/words.py"
    assert set(words.STILL) <= set(words.GONE)


def defined(path: str, source: str) -> set[str]:
    """Names of a module, its packages, and the classes, functions and constants in it."""
    names = {part.removesuffix(".py") for part in path.split("/")}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.col_offset == 0:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {ast.unparse(target) for target in targets}
    return names


def test_names_that_are_gone_do_not_come_back(words, repository):
    again = {
        f"{path.relative_to(repository).as_posix()}: {name}": say
        for path in sorted((repository / "flighttest").rglob("*.py"))
        for name in defined(path.relative_to(repository / "flighttest").as_posix(), path.read_text(encoding="utf-8"))
        for pattern, say in words.GONE_NAMES.items()
        if re.fullmatch(pattern, name)
    }
    assert {name: say for name, say in again.items() if name not in words.KEPT_NAMES} == {}
    assert set(words.KEPT_NAMES) <= set(again), "take these out of KEPT_NAMES"


def test_the_search_sees_names_of_each_kind():
    assert defined("a/doubts.py", "class Rows:\n    def once(self): ...\nWANDER = 1\nheld: int = 2") == {
        "a", "doubts", "Rows", "once", "WANDER", "held",
    }  # fmt: skip


def test_the_search_sees_words_in_names_and_in_any_case():
    texts = {"a.py": "flight_house_m, lighthouse", "the/house.py": "", "b.py": "a house"}
    assert found("house", texts) == {"a.py": 1, "the/house.py": 1, "b.py": 1}


def test_every_term_of_the_glossary_stands_in_its_module(words, repository):
    missing = [
        f"{e.term} in {e.where}"
        for e in words.GLOSSARY
        if not (repository / "flighttest" / e.where).is_file()
        or e.term.lower()
        not in " ".join((repository / "flighttest" / e.where).read_text(encoding="utf-8").lower().split())
    ]
    assert not missing


def test_a_textbook_word_is_found_by_search_in_the_module_that_is_about_it(words, repository):
    """As grep finds it: on one line, in a docstring or comment, spelt as in the textbook."""
    missing = [
        f"{word} in {where}"
        for word, where in words.SEARCHED
        if word.lower() not in (repository / "flighttest" / where).read_text(encoding="utf-8").lower()
    ]
    assert not missing
    assert len({word for word, _ in words.SEARCHED}) == len(words.SEARCHED) >= 36


def test_a_search_for_the_word_leads_to_the_module_that_answers(words, texts):
    astray = {}
    for _, word, where in words.QUESTIONS:
        hits = {
            name: sum(word.lower() in line for line in text.splitlines())  # as `grep -c` counts
            for name, text in texts.items()
            if name.startswith("flighttest/") and name.endswith(".py")
        }
        first = sorted((n for n in hits if hits[n]), key=lambda n: -hits[n])
        fourth = hits[first[3]] if len(first) > 3 else 1
        if hits[f"flighttest/{where}"] < max(fourth, 1):
            astray[word] = first[:4]
    assert len({question for question, _, _ in words.QUESTIONS}) == len(words.QUESTIONS) == 30
    assert not astray


def test_the_glossary_is_sorted_and_without_synonyms(words):
    terms = [e.term.lower() for e in words.GLOSSARY]
    assert len(terms) == len(set(terms))
    for pattern in words.GONE:
        assert not any(
            re.search(rf"(?<![a-z]){pattern}(?![a-z])", f"{e.term} {e.meaning}".lower()) for e in words.GLOSSARY
        )
