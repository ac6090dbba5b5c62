"""The documentation site contains every example, every public name and every page."""

import html
import importlib
import re
import sys
from pathlib import Path

import pytest

import warpcontact as wc

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="the site is in a checkout, not in an installed package")


@pytest.fixture
def gallery(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    yield __import__("gallery")
    del sys.modules["gallery"]


def test_every_example_has_gallery_entry_picture_and_output(gallery):
    # raises an error for an example without a place, and for a place without an example
    examples = gallery.examples()
    assert {example.name for example in examples} == {
        file.stem for file in gallery.EXAMPLES.iterdir() if file.suffix in (".py", ".toml")
    }
    for example in examples:
        begin = {".png": b"\x89PNG", ".jpg": b"\xff\xd8\xff"}[example.picture.suffix]
        assert example.picture.read_bytes().startswith(begin), example.name
        assert example.printed.read_text(encoding="utf-8").strip(), example.name
        assert gallery.page(example).count("literalinclude") == len(example.files)


def test_gallery_pictures_are_small(gallery):
    sizes = {example.name: example.picture.stat().st_size for example in gallery.examples()}
    assert max(sizes.values()) <= 150_000, max(sizes, key=sizes.get)
    assert sum(sizes.values()) <= 2_000_000


def test_example_without_gallery_entry_is_reported(gallery, tmp_path, monkeypatch):
    examples = tmp_path / "examples"
    examples.mkdir()
    (examples / "swing.py").write_text('"""A swing."""\n', encoding="utf-8")
    (tmp_path / "gallery.toml").write_text('["Joints"]\ndoor = { render = "" }\n', encoding="utf-8")
    monkeypatch.setattr(gallery, "EXAMPLES", examples)
    monkeypatch.setattr(gallery, "FOLDER", tmp_path)
    with pytest.raises(ValueError, match=r"examples/door does not exist, but is in docs/gallery/gallery\.toml"):
        gallery.examples()
    (tmp_path / "gallery.toml").write_text("[Joints]\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"examples/swing has no place in docs/gallery/gallery\.toml"):
        gallery.examples()


def test_gallery_text_and_commands_match_the_example_files(gallery):
    examples = {example.name: example for example in gallery.examples()}
    drop = examples["terrain_drop"]
    assert drop.summary.startswith("1024 spheres of different mass")
    assert drop.command(drop.files[0], "a.png") == (
        "warpcontact run examples/terrain_drop.toml --out results/terrain_drop"
    )
    lander = examples["lander"]
    assert [file.name for file in lander.files] == ["lander.py", "lander.toml"]
    assert "python examples/lander.py\n" not in gallery.story(lander.files[0])
    assert gallery.expected(examples["box_on_slope"].files[0]).startswith("Expected: the box slides")


def test_every_public_name_is_in_the_reference():
    text = "\n".join(page.read_text(encoding="utf-8") for page in sorted((DOCS / "api").glob("*.rst")))
    listed = re.findall(r"^\.\. (?:autoclass|autofunction|catalogue):: warpcontact\.(\w+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(wc.__all__) - {"__version__"})


def test_every_documentation_page_is_listed_once():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^- \[[^\]]+\]\((?!\.\.)([^)]+)\)", index, re.MULTILINE)
    pages = [path.relative_to(DOCS).as_posix() for path in (*DOCS.glob("*.md"), *DOCS.glob("api/*.rst"))]
    assert sorted(listed) == sorted(set(pages) - {"index.md"})


def test_every_source_path_in_the_pages_exists():
    pages = [*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    missing = [
        f"{page.name}: {path}"
        for page in pages
        for path in re.findall(
            r"`((?:warpcontact|kernels|tests|benchmarks|docs)/[\w/.]*)`", page.read_text("utf-8")
        )
        if not (ROOT / path).exists()
    ]
    assert missing == []


@pytest.mark.parametrize("script", ["run", "thorough", "gpu"])
def test_every_file_that_a_check_runs_exists(script):
    text = (ROOT / ".ci" / script).read_text("utf-8")
    assert [
        path for path in re.findall(r"(?:tests|examples)/[\w/.]+\.\w+", text) if not (ROOT / path).exists()
    ] == []


def test_package_drawing_shows_the_present_imports(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    drawn = html.unescape((DOCS / "images" / "packages.svg").read_text("utf-8"))
    assert importlib.import_module("package_graph").description() in drawn, "run python docs/package_graph.py"
