"""Pages of the documentation: links and paths exist, a page stays short, words are plain."""

from __future__ import annotations

import pkgutil
import re
import subprocess
from pathlib import Path

import pytest

from bench.house import WORD

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
GENERATED = ("docs/results/", "docs/paper/")
"""Written by commands: tables as long as their results."""

MOST_WORDS = 1200
PACKAGES = ("api", "bench", "docs", "estimation", "fleet_db", "ingest", "tests")
LOOSE = re.compile(
    r"\b(?:tells?|telling|feels?|hears?|lie|unless given|says what|without a word|let loose|come[s]? near(?:er|est)?"
    r"|to and fro|hurr(?:y|ies)|speaks?|storms?|mended|dealt)\b",
    re.IGNORECASE,
)
"""Words for which the field or plain English has a better one, beside those that ``make house`` counts."""

CODE_BLOCK = re.compile(r"^```.*?^```$|^ {4}[^\n]*$", re.MULTILINE | re.DOTALL)


def relative(page: Path) -> str:
    """Return a page's path inside the repository, for the names of tests."""
    return page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def files() -> frozenset[str]:
    """Return the paths of all files of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    return frozenset(path for path in listed if (ROOT / path).exists())


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        path, _, anchor = target.partition("#")
        if re.match(r"\w+:", target):
            continue
        linked = (page.parent / path).resolve() if path else page
        if not linked.exists() or (anchor and anchor not in anchors(linked)):
            broken.append(target)
    assert broken == []


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_paths_in_the_text_exist(page: Path, files: frozenset[str]) -> None:
    folders = {"/".join(parts[:n]) for parts in (path.split("/") for path in files) for n in range(1, len(parts))}
    names = {path.rpartition("/")[2] for path in files}
    missing = []
    for quoted in re.findall(r"`([^`\n]+)`", page.read_text()):
        if re.fullmatch(r"[\w.-]+\.py", quoted):
            missing += [] if quoted in names else [quoted]
        elif re.fullmatch(rf"(?:{'|'.join(PACKAGES)})/[a-z\d_./-]*", quoted):
            missing += [] if quoted.rstrip("/") in files | folders else [quoted]
        elif re.fullmatch(r"python -m bench\.\w+.*", quoted):
            missing += [] if f"bench/{quoted.split()[2].removeprefix('bench.')}.py" in files else [quoted]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_names_of_the_code_exist(page: Path) -> None:
    quoted = set(re.findall(r"`((?:estimation|ingest|api|fleet_db)(?:\.\w+)+)`", page.read_text()))
    for name in quoted:
        pkgutil.resolve_name(name)


@pytest.mark.parametrize("page", [page for page in PAGES if not relative(page).startswith(GENERATED)], ids=relative)
def test_a_page_is_short(page: Path) -> None:
    assert relative(page) == "CHANGELOG.md" or len(page.read_text().split()) <= MOST_WORDS


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_words_are_plain(page: Path) -> None:
    text = CODE_BLOCK.sub("", page.read_text())
    text = re.sub(r"`[^`]*`", "", text)
    found = [match for words in (WORD, LOOSE) for match in words.finditer(text)]
    assert [text[max(0, match.start() - 30) : match.end() + 20] for match in found] == []
