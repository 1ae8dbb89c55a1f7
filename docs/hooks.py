"""What the site's builder calls: it adds what is made from the code."""

import posixpath
import re
from pathlib import Path

from made_pages import expanded, made_pages
from mkdocs.structure.files import File
from PIL import Image


def on_files(files, config):
    """Add the pages that are made."""
    for path, text in made_pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put what is made into a page that asks for it."""
    return expanded(markdown, page.file.src_uri)


def on_page_content(html, page, config, files):
    """Let a browser load a picture when it is near the screen; the films are heavy."""
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

    return re.sub(r'<img [^>]*src="(?P<source>[^"]+)"', lazy, html)
