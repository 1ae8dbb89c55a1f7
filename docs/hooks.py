"""What the site's builder calls: it adds what is made from the code."""

import io
import posixpath
import re
from pathlib import Path

from made_pages import expanded, made_pages, still
from mkdocs.structure.files import File
from PIL import Image


def on_files(files, config):
    """Add the pages that are made."""
    for path, text in made_pages().items():
        files.append(File.generated(config, path, content=text))
    docs = Path(config["docs_dir"])
    for film in sorted(docs.glob("media/baselines/*.gif")):
        path = still(film.relative_to(docs).as_posix())
        files.append(File.generated(config, path, content=_still(film)))
    return files


def _still(film: Path) -> bytes:
    """Return a film's picture after 1.5 seconds, as JPEG."""
    content = io.BytesIO()
    with Image.open(film) as image:
        image.seek(min(15, image.n_frames - 1))
        image.convert("RGB").save(content, format="JPEG", quality=85)
    return content.getvalue()


def on_page_markdown(markdown, page, config, files):
    """Put what is made into a page that asks for it."""
    return expanded(markdown, page.file.src_uri)


def on_page_content(html, page, config, files):
    """Load pictures when they are near the screen, and keep names of options whole."""
    html = re.sub(
        r"<code>(--[a-z0-9-]+)</code>", r'<code class="whole">\1</code>', html
    )
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
