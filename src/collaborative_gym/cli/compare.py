"""The command that compares training runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from collaborative_gym.cli.terminal import File, Folder, check_files, put, tell


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare training runs, whatever they differ in, with intervals over seeds.

    It finds the settings in which the runs differ. It prints interquartile means,
    medians and means of the last validations, the steps and core-seconds to 90 %
    completion, and how likely a run of one kind beats a run of another kind.

    Attributes:
      runs: folders of runs, or folders that have runs in them at any depth.
      measure: measure of the validations, such as return, for curves, profiles and
        probabilities.
      output: folder for compare.md, .csv, .json, .svg and .pdf, and marl_eval.json for
        the package id-marl-eval.
      json: file for all numbers; - for standard output.
    """

    runs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="RUN | FOLDER ...", help_behavior_hint="(required)"),
    ]
    measure: Annotated[
        str | None,
        tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: completion)"),
    ] = None
    output: Folder = None
    json: File = None

    def run(self) -> None:
        """Print tables and write the files."""
        from collaborative_gym.cli.tables import comparison_tables
        from collaborative_gym.comparisons.picture import draw_comparison
        from collaborative_gym.comparisons.result import compare

        folder = self.output or Path()
        kinds = {} if self.output is None else {"md", "csv", "json", "svg", "pdf"}
        files = {kind: folder / f"compare.{kind}" for kind in kinds}
        check_files(*files.values(), self.json)
        compared = compare(self.runs, measure=self.measure)
        besides = (self.json,)
        tell(compared.statement, besides=besides)
        for table in comparison_tables(compared):
            tell("", besides=besides)
            tell(table, besides=besides)
        put(self.json, compared.to_json())
        if self.output is None:
            return
        put(files["md"], compared.to_markdown())
        put(files["csv"], compared.to_csv())
        put(files["json"], compared.to_json())
        put(folder / "marl_eval.json", compared.to_marl_eval())
        but = ""
        try:
            draw_comparison(compared, files["svg"], files["pdf"])
        except ImportError as error:
            but = f", but no picture: {error}"
        tell(f"\nwrote {folder}{but}", besides=besides)
