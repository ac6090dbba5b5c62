"""Sphinx extension: one page per example, with description, commands, output and code.

Every file in ``examples/`` has a page; ``gallery/gallery.toml`` sets its part of the gallery and the recipe of its
picture.
"""

import ast
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parent
EXAMPLES = DOCS.parent / "examples"
FOLDER = DOCS / "gallery"
#: Commands in a description; the page lists them separately.
COMMANDS = re.compile(r"^ {4}(?:python|warpcontact) .*\n|\s*Run it with\s+``[^`]*``\.", re.MULTILINE)
INTRODUCTION = """\
# Examples

Each example is a script, an experiment file, or both. It ends with a number that a test checks.
"""


@dataclass(frozen=True)
class Example:
    """Files of one name in ``examples/``.

    Args:
        name: File name without suffix.
        part: Part of the gallery.
        recipe: Recipe of its picture, from ``gallery.toml``.
    """

    name: str
    part: str
    recipe: dict[str, Any]

    @property
    def title(self) -> str:
        """Title of its page."""
        return self.name.replace("_", " ").capitalize()

    @property
    def files(self) -> list[Path]:
        """Its files; the script comes first."""
        return sorted(EXAMPLES.glob(f"{self.name}.*"))

    @property
    def picture(self) -> Path:
        """Path of its picture: JPEG if rendered, PNG for a plot."""
        rendered = not {"render", "recording"}.isdisjoint(self.recipe)
        return FOLDER / f"{self.name}{'.jpg' if rendered else '.png'}"

    @property
    def printed(self) -> Path:
        """Path of its printed output."""
        return FOLDER / f"{self.name}.txt"

    @property
    def summary(self) -> str:
        """First sentence of its description."""
        first = story(self.files[0]).partition("\n\n")[0].replace("\n", " ")
        return re.split(r"(?<=\.) ", first)[0].rstrip(":.") + "."

    def command(self, file: Path, picture: str) -> str:
        """Returns the command that runs one of its files; a script that draws writes ``picture``."""
        if file.suffix == ".toml":
            return f"warpcontact run examples/{file.name} --out results/{self.name}"
        return f"python examples/{file.name} {self.recipe.get('options', '')}".rstrip().format(picture=picture)

    def render(self, picture: str) -> str:
        """Returns the command that draws the results of its run."""
        return f"warpcontact render results/{self.name} {self.recipe['render']} -o {picture}"


def examples() -> list[Example]:
    """Returns all examples, in the order of the gallery.

    Raises:
        ValueError: If an example is not in ``gallery.toml``, or an entry there has no example.
    """
    parts = tomllib.loads((FOLDER / "gallery.toml").read_text(encoding="utf-8"))
    found = [Example(name, part, recipe) for part, entries in parts.items() for name, recipe in entries.items()]
    there = {file.stem for file in EXAMPLES.iterdir() if file.suffix in (".py", ".toml")}
    for name in sorted(there.symmetric_difference(example.name for example in found)):
        what = "has no place in" if name in there else "does not exist, but is in"
        raise ValueError(f"examples/{name} {what} docs/gallery/gallery.toml")
    return found


def story(file: Path) -> str:
    """Returns the description of an example: its docstring, or its leading comment."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        description = ast.get_docstring(ast.parse(text)) or ""
    else:
        description = uncommented(re.match(r"(?:#.*\n)*", text)[0])
    return COMMANDS.sub("", description).replace("::\n", ":\n").strip()


def expected(file: Path) -> str:
    """Returns the final comment of an experiment file, which states the expected result."""
    end = re.search(r"^# (Expected(?:.*\n)(?:#.*\n)*)\Z", file.read_text(encoding="utf-8"), re.MULTILINE)
    return uncommented("# " + end[1]).strip() if end else ""


def uncommented(comment: str) -> str:
    """Returns the text of a comment."""
    return re.sub(r"^# ?", "", comment, flags=re.MULTILINE)


def page(example: Example) -> str:
    """Returns the page of an example as Markdown."""
    description = [story(file) for file in example.files]
    picture = f"{example.name}.png"
    commands = [example.command(file, picture) for file in example.files]
    if "render" in example.recipe:
        commands.append(example.render(picture))
    promised = [expected(file) for file in example.files]
    parts = [
        f"# {example.title}",
        *description,
        f"![{example.summary}]({example.picture.name})",
        "## Run it",
        "```bash\n" + "\n".join(commands) + "\n```",
        "It prints",
        f"```text\n{example.printed.read_text(encoding='utf-8').rstrip()}\n```",
        *filter(None, promised),
    ]
    for file in example.files:
        language = {".py": "python", ".toml": "toml"}[file.suffix]
        parts += [
            f"## {file.name}",
            f"```{{literalinclude}} ../../examples/{file.name}\n:language: {language}\n```",
        ]
    return "\n\n".join(parts) + "\n"


def overview(every: list[Example]) -> str:
    """Returns the page with all examples as Markdown."""
    parts = [INTRODUCTION]
    for part in dict.fromkeys(example.part for example in every):
        own = [example for example in every if example.part == part]
        cards = "\n".join(card(example) for example in own)
        pages = "\n".join(example.name for example in own)
        parts += [
            f"## {part}",
            f"`````{{container}} cards\n{cards}`````",
            f"```{{toctree}}\n:hidden:\n\n{pages}\n```",
        ]
    return "\n\n".join(parts) + "\n"


def card(example: Example) -> str:
    """Returns the card of an example: picture, title, first sentence."""
    link = f"({example.name}.md)"
    return (
        f"````{{container}} card\n[![{example.title}]({example.picture.name})]{link}\n\n"
        f"[{example.title}]{link}: {example.summary}\n````\n"
    )


def write_pages(app: "Sphinx") -> None:
    """Writes the pages."""
    from outside import write
    from sphinx.errors import ExtensionError

    try:
        every = examples()
        for example in every:
            write(FOLDER / f"{example.name}.md", page(example))
    except (ValueError, FileNotFoundError) as error:
        raise ExtensionError(f"gallery: {error}; python docs/pictures.py NAME makes a picture") from None
    write(FOLDER / "index.md", overview(every))


def setup(app: "Sphinx") -> dict[str, Any]:
    """Registers the extension with Sphinx."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
