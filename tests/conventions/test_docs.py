"""Prose that can be computed is computed: the generated parts of the docs are current."""

import importlib.util

import pytest


@pytest.fixture(scope="module")
def generate(repository):
    spec = importlib.util.spec_from_file_location("docs_generate", repository / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_docs_are_current(generate):
    assert generate.stale() == [], "run make docs"


def test_the_check_sees_a_stale_page(generate, tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "DOCS", tmp_path)
    (tmp_path / "terms.md").write_text("<!-- generated: terms -->\nold\n<!-- end -->\n")
    assert generate.stale() == ["cli.md", "finding_things.md", "glossary.md", "terms.md"]


def test_every_command_has_help_and_json(generate):
    for name, command in generate.cli.commands.items():
        assert command.help, name
        assert any("--json" in option.opts for option in command.params), name
