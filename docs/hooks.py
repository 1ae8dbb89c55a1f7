"""What the site's builder calls."""

import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File
from PIL import Image


def on_files(files, config):
    """Add the pages that stand at the repository's root, as its readers expect."""
    root = Path(config["docs_dir"]).parent
    for name in ("CHANGELOG", "CONTRIBUTING"):
        text = (root / f"{name}.md").read_text().replace("](docs/", "](")
        files.append(File.generated(config, f"{name.lower()}.md", content=text))


def on_page_markdown(markdown, page, config, files):
    """Put the whole docstrings below each list of Python's names.

    What leads to a file of the repository leads nowhere here. A search finds guides
    before studies, and tables at last.
    """
    path = page.file.src_uri
    room = path.rpartition("/")[0] or path
    boosts = {"index.md": 6, "changelog.md": 1, "contributing.md": 1, "tables": 0.2}
    page.meta["search"] = {"boost": boosts.get(room, 1 if room != path else 3)}

    def whole(made):
        names = re.findall(r'^- <a id="(collaborative_gym[^"]*)"', made[0], re.M)
        return "\n\n".join((made[0], *(f"::: {name}" for name in names)))

    markdown = re.sub(r"\[(`[^`]+`)\]\(\.\./examples/[^)]+\)", r"\1", markdown)
    return re.sub(r"<!-- made: names .*?<!-- end -->", whole, markdown, flags=re.S)


def on_page_content(html, page, config, files):
    """Load pictures late, play films, keep options whole, drop the files' anchors."""
    html = re.sub(
        r"<code>(--[a-z0-9-]+)(.*?)</code>",
        r'<code><span class="whole">\1</span>\2</code>',
        html,
    )
    html = re.sub(r"<pre.*?</pre>", _keep_words, html, flags=re.S)
    html = re.sub(r'<a id="collaborative_gym[^"]*"></a>', "", html)
    here = posixpath.dirname(page.url)

    def lazy(match):
        tag, source = match.group(0), match.group("source")
        path = Path(
            config["docs_dir"], posixpath.normpath(posixpath.join(here, source))
        )
        if "width=" in tag or path.suffix == ".svg" or not path.exists():
            return tag
        # Without a size it takes no room, and all of them are near the screen.
        with Image.open(path) as image:
            width, height = image.size
        return f'{tag} loading="lazy" width="{width}" height="{height}"'

    html = re.sub(r'<img [^>]*src="(?P<source>[^"]+)"', lazy, html)
    return re.sub(r'<a href="([^"]+\.mp4)"><img (.*?)></a>', _film, html)


def _film(link):
    """Return what plays a film in place of a picture that leads to it."""
    picture = re.sub(r"\balt=", "aria-label=", link[2].removesuffix("/"))
    picture = picture.replace("src=", "poster=").replace('loading="lazy"', "")
    how = 'controls loop muted playsinline preload="none"'
    return f'<video src="{link[1]}" {how} {picture}></video>'


def _keep_words(block):
    """Return a block of code whose options and ids do not break at their hyphens."""
    word = r"(?<![\w-])--[a-z][a-z-]*|\b\w+-v\d\b"
    return re.sub(word, r'<span class="whole">\g<0></span>', block[0])
