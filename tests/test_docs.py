"""The documents: links and paths resolve, quoted commands and options exist, the README stays short."""

import re
from pathlib import Path

import pytest

import mapmend
from mapmend.cli import main
from mapmend.config import Config, to_dict

ROOT = Path(__file__).parents[1]
PAGES = [
    page for folder in ("", "docs", "docs/decisions", "benchmarks") for page in sorted((ROOT / folder).glob("*.md"))
]


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def is_there(page: Path, target: str) -> bool:
    name, _, anchor = target.partition("#")
    to = page.parent / name if name else page
    return to.exists() and (not anchor or anchor in anchors(to))


def test_links_resolve():
    links = [(page, target) for page in PAGES for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text())]
    local = [(page, target) for page, target in links if not target.startswith("http")]
    assert len(local) > 100
    assert [(page.name, target) for page, target in local if not is_there(page, target)] == []


def test_named_python_files_exist():
    named = [(page, name) for page in PAGES for name in re.findall(r"`((?:\w+/)+\w+\.py)`", page.read_text())]
    places = (ROOT, ROOT / "src/mapmend", ROOT / "tests")
    assert len(named) > 100
    assert [(page.name, name) for page, name in named if not any((place / name).exists() for place in places)] == []


def test_functions_and_tests_named_for_the_papers_exist():
    page = (ROOT / "docs/papers.md").read_text()
    named = []
    for names, file in re.findall(r"((?:`[\w.]+`(?:, )?)+) in `([\w/]+\.py)`", page):
        named += [(ROOT / "src/mapmend" / file, name) for name in re.findall(r"`(?:\w+\.)?(\w+)`", names)]
    for file, names in re.findall(r"`([\w/]+\.py)`: ((?:`test_\w+`(?:, )?)+)", page):
        named += [(ROOT / "tests" / file, name) for name in re.findall(r"`(\w+)`", names)]
    assert len(named) > 100
    missing = [(file, name) for file, name in named if not re.search(rf"(def|class) {name}\b", file.read_text())]
    assert [(file.name, name) for file, name in missing] == []


def test_each_decision_has_its_number_and_is_in_the_index():
    folder = ROOT / "docs/decisions"
    names = sorted(page.name for page in folder.glob("[0-9]*.md"))
    assert [int(name[:3]) for name in names] == list(range(1, len(names) + 1))
    index = (folder / "README.md").read_text()
    titles = {name: (folder / name).read_text().splitlines()[0].removeprefix(f"# {name[:3]}: ") for name in names}
    assert [name for name in names if f"- [{name[:3]}]({name}): {titles[name]}\n" not in index] == []


def test_each_benchmark_is_in_the_table_of_benchmarks():
    table = (ROOT / "benchmarks/README.md").read_text()
    scripts = [path.name for path in (ROOT / "benchmarks").glob("[a-z]*.py")]
    assert [name for name in scripts if f"| `{name}" not in table and f"(`{name}" not in table] == []


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def help_of(capsys, *words: str) -> str:
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    return capsys.readouterr().out


def test_quoted_python_names_are_public():
    pages = [(ROOT / name).read_text() for name in ("README.md", "docs/python.md", "docs/architecture.md")]
    names = {name for page in pages for name in re.findall(r"\bmapmend\.(\w+)\(", page)}
    assert len(names) > 5
    assert names - set(mapmend.__all__) == set()


def test_quoted_commands_and_options_exist(capsys):
    quoted = []
    for name in ("README.md", "docs/using.md", "docs/measured.md", "docs/formats.md"):
        page = (ROOT / name).read_text()
        quoted += re.findall(r"^ {4}mapmend ([a-z][^#\n]*)", page, re.MULTILINE)
        quoted += re.findall(r"`mapmend ([a-z][^`]*)`", page)
    assert len(quoted) > 30
    known = re.findall(r"^    ([a-z]+)\b", help_of(capsys), re.MULTILINE)
    assert [line for line in quoted if line.split()[0] not in known] == []
    helps = {command: help_of(capsys, command) for command in {line.split()[0] for line in quoted}}
    for line in quoted:
        options = re.findall(r"(?<=\s)--?[a-z][a-z-]*", line)
        assert [option for option in options if not re.search(rf"{option}\b", helps[line.split()[0]])] == [], line


def test_each_setting_has_its_reason_in_the_table():
    """But for the switches that say what is wanted: no value of theirs is chosen well or badly."""
    rows = [row for row in (ROOT / "docs" / "settings.md").read_text().splitlines() if row.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`(\w+\.\w+)`", row.split("|")[1])}
    blocks = {block: table for block, table in to_dict(Config()).items() if isinstance(table, dict)}
    settings = {f"{block}.{name}" for block, table in blocks.items() for name in table}
    assert settings - named == {"loops.enabled", "motion.use_odometry"}
