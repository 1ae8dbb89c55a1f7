"""What the site's builder calls: it adds what is made from the code."""

from made_pages import expanded, made_pages
from mkdocs.structure.files import File


def on_files(files, config):
    """Add the pages that are made."""
    for path, text in made_pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put what is made into a page that asks for it."""
    return expanded(markdown, page.file.src_uri)
