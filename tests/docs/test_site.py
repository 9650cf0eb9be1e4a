"""`make site` makes a site of all pages and public names, which fits on a telephone."""

import re
import subprocess
from html import unescape
from pathlib import Path

import pytest
from api_pages import public_names, public_thing
from browser import chromium

pytestmark = [pytest.mark.heavy, pytest.mark.timeout(900)]
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("results/*.md")])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, made without a warning."""
    folder = tmp_path_factory.mktemp("site")
    installed = [f"--old-file=.venv/{name}" for name in ("ready", "site/ready")]
    command = ["make", "--silent", *installed, "site", f"OUT={folder}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def words(text: str) -> str:
    return re.sub(r"\W+", " ", text).strip()


def test_every_page_is_in_the_site_and_in_its_navigation(site: Path) -> None:
    navigation = (site / "index.html").read_text("utf-8")
    for page in PAGES:
        title = page.read_text("utf-8").partition("\n")[0].removeprefix("# ")
        name = page.relative_to(DOCS).with_suffix("").as_posix()
        shown = (site / f"{name}.html").read_text("utf-8")
        heading = re.search(r"<h1>(.*?)<a class=\"headerlink", shown, flags=re.DOTALL)
        assert heading, page.name
        assert words(unescape(re.sub(r"<[^>]+>", "", heading[1]))) == words(title), page.name
        assert name == "index" or f'<a class="reference internal" href="{name}.html">' in navigation


def test_every_public_class_has_an_entry(site: Path) -> None:
    for module, names in public_names().items():
        page = (site / "modules" / f"{module}.html").read_text("utf-8")
        for place in [f"{module}.{name}" for name in names if isinstance(public_thing(module, name), type)]:
            linked = rf'<a class="reference internal" [^>]*><code [^>]*><span class="pre">{re.escape(place)}<'
            assert f'id="{place}"' in page or re.search(linked, page), place


def test_no_page_is_wider_than_a_telephone(site: Path) -> None:
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 400, "height": 900}, offline=True)
        widths = {}
        for file in sorted([*site.glob("*.html"), *site.glob("*/*.html")]):
            page.goto(file.as_uri())
            widths[file.name] = page.evaluate("document.documentElement.scrollWidth")
        page.close()
    assert {name: width for name, width in widths.items() if width > 400} == {}
