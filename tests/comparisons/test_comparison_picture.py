"""The picture of a comparison, and the command that draws it."""

import json

import pytest

pytest.importorskip("matplotlib", reason="needs the extra train")

import collaborative_gym as cg
from collaborative_gym.cli.main import main
from collaborative_gym.comparisons.picture import comparison_figure, draw_comparison


def test_a_panel_for_each_environment_then_the_profile_and_the_improvement(two_modes):
    figure = comparison_figure(cg.compare(two_modes))
    assert figure.get_figwidth() == 7.16
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["(a) CarryPandas-v0", "(b) profile", "(c) improvement"]
    curves = figure.axes[0]
    first, second = curves.get_lines()
    assert (first.get_label(), second.get_label()) == ("collaborative", "independent")
    assert first.get_ydata()[-1] == pytest.approx(80.0)
    assert len(curves.collections) == 2  # The intervals.
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["collaborative", "independent"]


def test_one_environment_beside_another_share_a_panel(write_run, tmp_path):
    for env in ("A-v0", "B-v0"):
        write_run(env, (0.0, 1.0), env=env)
    figure = comparison_figure(cg.compare(tmp_path))
    labels = [line.get_label() for line in figure.axes[0].get_lines()]
    assert labels == ["A-v0", "B-v0"]


def test_names_too_long_for_a_panel_are_numbered_and_keep_their_lines(
    write_run, tmp_path, recwarn
):
    long = "AnEnvironmentWithQuiteALongName"
    named = f"{long}-v0", f"{long}-v1 ({'of many settings, ' * 8}and more)", "Short-v0"
    for i, name in enumerate(named):
        write_run(f"run{i}", (0.0, 1.0), env=name)
    figure = comparison_figure(cg.compare(tmp_path))
    improvement = figure.axes[-1]
    assert [text.get_text() for text in improvement.texts] == [
        "1 over 2",
        "1 over 3",
        "2 over 3",
    ]
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert [label.replace("\n", " ") for label in labels] == [
        f"{i + 1}: {name}" for i, name in enumerate(named)
    ]
    figure.draw_without_rendering()
    assert not recwarn.list  # Matplotlib warns where a layout has no room.
    box = legend.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
    tops = [axes.get_tightbbox().y1 for axes in figure.axes]
    assert max(tops) <= box.y0
    assert {axes.bbox.height > 0.5 * 2.2 * figure.dpi for axes in figure.axes} == {True}


def test_pictures_are_the_same_bytes_whenever_they_are_drawn(two_modes, tmp_path):
    compared = cg.compare(two_modes)
    for suffix in ("svg", "pdf"):
        files = [tmp_path / f"{i}.{suffix}" for i in range(2)]
        for file in files:
            draw_comparison(compared, file)
        assert files[0].read_bytes() == files[1].read_bytes()
        assert files[0].stat().st_size > 5000


def test_the_command_tells_what_differs_and_writes_all_files(
    two_modes, tmp_path, capsys
):
    folder = tmp_path / "out"
    assert main(["compare", str(two_modes), "--output", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "They differ in mode (collaborative, independent)." in printed
    told = printed.partition("wrote ")[0]
    assert max(map(len, told.splitlines())) <= 80
    names = {file.name for file in folder.iterdir()}
    ends = ("md", "csv", "json", "svg", "pdf")
    assert names == {"marl_eval.json", *(f"compare.{end}" for end in ends)}
    assert main(["compare", str(two_modes), "--json", "-"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["differences"] == {"mode": ["collaborative", "independent"]}


def test_the_command_meets_bad_input_with_a_sentence(two_modes, capsys):
    assert main(["compare", "nowhere"]) == 2
    assert "no training run in 'nowhere'" in capsys.readouterr().err
    assert main(["compare", str(two_modes), "--measure", "retrun"]) == 2
    assert "did you mean 'return'" in capsys.readouterr().err
