"""A page's panel: the controls, the choices, and the measures."""

import html
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import viser

from collaborative_gym.pictures.rendering import CAMERA
from collaborative_gym.viewer.menu import Choice, Menu
from collaborative_gym.viewer.reading import Reading, meanings
from collaborative_gym.viewer.session import FASTEST, SLOWEST, Session
from collaborative_gym.viewer.stage import NEWTONS_PER_METRE

_PAUSE = 0.5  # time between two pictures of a chart, in s of the user's time

_COLORS = "#333", "#c22", "#17c", "#294", "#e50", "#64d", "#089", "#a15"

_PER_STEP = "reward per step"  # unit of the charts of rewards

_STYLES, _SCRIPT = (
    Path(__file__).with_name(f"panel.{kind}").read_text() for kind in ("css", "js")
)
"""Looks of all tabs, and what they do at first and when another choice plays."""


class Panel:
    """The panel of all tabs, which share its controls; `on_view` gets a view."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        menu: Menu,
        *,
        on_view: Callable[[str], None],
    ):
        self._session, self._menu, self._gui = session, menu, server.gui
        self._tabs = server.get_clients
        self._said: Reading | None = None
        self._offered: tuple[Any, ...] = ()
        self._offers: list[Any] = []
        self._wished, self._instead = self._choice.policies, ""
        gui = server.gui
        gui.set_panel_label("Collaborative Gym")
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._heading = gui.add_html("")
        self._add_controls()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Now"):
            self._table = gui.add_html("")
        with tabs.add_tab("Choose"):
            self._choices = gui.add_folder(None)
            self._singles = gui.add_folder("Each robot", expand_by_default=False)
            self._link = gui.add_html("")
        self._plots = Plots(gui, tabs.add_tab("Plots"))
        self._on_view = on_view
        with tabs.add_tab("Look"):
            self._add_looks()
        self._script = gui.add_html("")
        self._hint = gui.add_html("<div class=hint>Ctrl-drag to pull an object</div>")

    @property
    def view(self) -> str:
        """The chosen camera."""
        return self._view.value

    @property
    def looks(self) -> dict[str, bool]:
        """The arguments of `Stage.refresh`."""
        return {name: box.value for name, box in self._looks.items()}

    def refresh(self) -> None:
        """Bring the panel up to date. Only the session's thread may call this."""
        session = self._session
        self._play.label = "Play" if session.is_paused else "Pause"
        self._plots.refresh(session)
        self._hint.visible = self._looks["labels"].value and not session.was_pulled
        reading = session.reading
        if self._said is reading:
            return
        self._said = reading
        self._heading.content = _heading(session, self._instead)
        self._worlds.value = self._worlds.options[session.world]
        said = meanings(type(session.env.task), type(session.env.facts))
        self._table.content = _table(reading.rows, said)
        last, now = session.film[-1].readings, session.readings
        self._time.max = max([session.env.control_dt, *(each.time for each in last)])
        self._time.value = max(each.time for each in now)
        offered = session.env, session.policies, reading.trouble
        if self._offered != offered:
            self._offered = offered
            self._offer()
        link = html.escape(replace(self._choice, episode=reading.episode).link)
        copy = "<button class=copy>Copy</button>"
        self._link.content = _STYLE % f'<a href="{link}">Link to this start</a> {copy}'

    def offer_views(self, views: Iterable[str]) -> None:
        """Offer the cameras of another world."""
        self._view.options = views

    def play(self, choice: Choice, wished: Iterable[str] = (), tab: Any = None) -> None:
        """Let the session play a choice, as far as they can by policies wished for.

        All tabs show a notice but the one that chose it.
        """
        for other in self._tabs().values():
            if other is not tab:
                other.add_notification(
                    "Another tab chose", choice.title, auto_close_seconds=20
                )
        self._wished = tuple(wished) or choice.policies
        pairs = zip(self._wished, choice.policies, strict=False)
        lost = ", ".join(dict.fromkeys(old for old, new in pairs if old != new))
        self._instead = lost and f"the expert plays in place of {lost}"
        self._session.change(
            lambda env: self._menu.load(choice, env), choice.seed, choice.episode
        )

    def _add_controls(self) -> None:
        session, gui = self._session, self._gui
        self._play = gui.add_button("Pause", hint="Pause or continue: space")
        moves = {"Step": session.step, "Reset": session.reset}
        moves |= {"Back": session.back, "Next": session.next}
        hint = (
            "Do one step (right arrow), start again (backspace), see the end of the"
            " last episode, or the next (enter)"
        )
        self._moves = gui.add_button_group("Episode", list(moves), hint=hint)
        self._time = gui.add_slider(
            "Time, s", 0.0, 1.0, 0.1, 0.0, hint="Go back and forth in the episode"
        )
        worlds = [f"world {i + 1}" for i in range(session.env.num_envs)]
        self._worlds = gui.add_dropdown(
            "World", worlds, visible=len(worlds) > 1, hint="Which one the panel shows"
        )
        # Not in a tab, since panel.js finds no label in a tab that is not open.
        self._shadows = gui.add_checkbox(
            "Shadows", True, hint="Slow without a graphics card"
        )
        self._play.on_click(
            lambda _: session.play() if session.is_paused else session.pause()
        )
        self._moves.on_click(lambda event: moves[event.target.value]())
        step = session.env.control_dt
        _on_user(self._time, lambda value: session.seek(round(value / step)))
        _on_user(self._worlds, lambda world: self._read(worlds.index(world)))

    def _add_looks(self) -> None:
        session, gui = self._session, self._gui
        self._speed = gui.add_slider("Speed", SLOWEST, FASTEST, 0.1, session.speed)
        _on_user(self._speed, lambda value: setattr(session, "speed", value))
        self._view = gui.add_dropdown("Camera", [CAMERA], hint="Where you look from")
        _on_user(self._view, self._on_view)
        back = gui.add_button("Reset camera", hint="Look from there again")
        back.on_click(lambda _: self._on_view(self.view))
        hint = "Start the next episode a second after a success"
        moves_on = gui.add_checkbox("Move on", session.moves_on, hint=hint)
        _on_user(moves_on, lambda value: setattr(session, "moves_on", value))
        forces = f"Arrows that are 1 m long for {NEWTONS_PER_METRE:g} N"
        self._looks = {
            "shadows": self._shadows,
            "labels": gui.add_checkbox("Labels", True, hint="The policy of each arm"),
            "forces": gui.add_checkbox("Contact forces", False, hint=forces),
        }

    def _read(self, world: int) -> None:
        self._session.look(world)
        if self.view != CAMERA:
            self._on_view(self.view)

    @property
    def _choice(self) -> Choice:
        return self._menu.chosen(self._session.env, self._session.policies)

    def _offer(self) -> None:
        menu, choice, env = self._menu, self._choice, self._session.env
        for old in self._offers:
            old.remove()
        starts, sides = menu.randomizations(choice.env), env.sides
        task = next(name for name, own in menu.tasks.items() if choice.env in own)
        is_team = self._singles.visible = len(env.agents) > 2
        with self._choices:
            offers = [
                self._ask("Task", menu.tasks, task, menu.turned),
                self._ask("Environment", menu.tasks[task], choice.env, menu.moved),
                self._ask("Starts", starts, choice.randomization, menu.drawn),
            ]
            for side, agents in sides.items() if is_team else ():
                who = f"{side}, " if len(sides) > 1 else "All "
                which = map(env.agents.index, agents)
                offers += self._ask_for(f"{who}arms", f"{who}policies", choice, *which)
        with self._singles if is_team else self._choices:
            for i, agent in enumerate(env.agents):
                labels = f"{agent}, arm", f"{agent}, policy"
                offers += self._ask_for(*labels, choice, i)
        self._offers = offers
        script = f"const TITLE = {json.dumps(choice.title)};{_SCRIPT}"
        # An image that cannot be loaded runs it: pages run no scripts that come later.
        self._script.content = (
            f"<style>{_STYLES}</style>"
            f'<img src="data:," hidden onerror="{html.escape(script)}">'
        )

    def _ask_for(self, arms: str, policies: str, now: Choice, *which: int) -> list[Any]:
        """Offer arms and policies for agents, which are given by their indices."""
        menu, able = self._menu, self._menu.policies(now)
        arm, policy = (
            own[which[0]] if len({own[i] for i in which}) == 1 else "mixed"
            for own in (now.robots, now.policies)
        )
        hint = "expert: scripted; baseline, ego: trained; others do not help, or little"
        return [
            self._ask(arms, menu.robots, arm, menu.armed, *which),
            self._ask(policies, able, policy, menu.led, *which, hint=hint),
        ]

    def _ask(
        self,
        label: str,
        options: Iterable[str],
        value: str,
        change: Callable[..., Choice],
        *agents: int,
        hint: str | None = None,
    ) -> Any:
        names = list(dict.fromkeys([*options, value]))
        box = self._gui.add_dropdown(label, names, initial_value=value, hint=hint)
        box.on_update(lambda event: self._take(event, change, agents))
        return box

    def _take(
        self, event: Any, change: Callable[..., Choice], agents: Iterable[int]
    ) -> None:
        if event.client is None:
            return
        now, wished, name = self._choice, self._wished, event.target.value
        choice = change(replace(now, policies=wished), name, *agents)
        if (now.env, now.robots) == (choice.env, choice.robots):
            wished, choice = choice.policies, change(now, name, *agents)
        self.play(choice, wished, event.client)


_STYLE = "<div class=said>%s</div>"  # frame of what the panel says


def _on_user(box: Any, do: Callable[[Any], object]) -> None:
    box.on_update(lambda event: event.client and do(event.target.value))


def _heading(session: Session, instead: str) -> str:
    task, reading = session.env.task, session.reading
    done, name = "", task.progress_name
    if name and task.units.get(name) == "":
        done = f", {100 * reading.measures[name]:.0f} % done"
    sides = [
        f"{player} <b>{reading.scores[side]:g}</b>"
        if side in reading.scores
        else f"{player}{': <b>success</b>' if reading.success[side] else done}"
        for side, player in ((s, html.escape(p)) for s, p in reading.players.items())
    ]
    goal = html.escape(task.summary)
    if reading.is_loading:
        goal, sides = "loading ...", []
    lines = [f"<b>stopped:</b> {html.escape(reading.trouble)}"] * bool(reading.trouble)
    lines += [f"<b>{html.escape(instead)}</b>"] * bool(instead)
    # A line breaks between the sides first.
    spans = (f"<span style=display:inline-block>{side}</span>" for side in sides)
    lines.append(" : ".join(spans))
    if reading.scores:
        last = reading.previous.partition(";")[0]
        lines.append(html.escape(last and f"before: {last}") or "&nbsp;")
    worlds = session.readings
    if len(worlds) > 1 and not reading.scores:
        done = sum(any(each.success.values()) for each in worlds)
        lines.append(f"success in {done} of {len(worlds)} worlds")
    return _STYLE % (f"<div class=goal>{goal}</div>" + "<br>".join(lines))


def _table(rows: Iterable[tuple[str, str]], meanings: Mapping[str, str]) -> str:
    """Return rows of names and values as HTML; the pointer shows a name's meaning."""
    lines, of_part = "", ""
    for name, value in rows:
        if is_heading := not name.startswith(" "):
            of_part = "reward " if name.startswith("reward") else ""
        word = of_part + name.strip()
        title = meanings.get(word) or meanings.get(word.rpartition(" ")[0], "")
        lines += (
            f"<tr{'' if is_heading else ' class=part'}>"
            f'<td title="{html.escape(title)}">{html.escape(name)}'
            f"<td>{html.escape(value)}"
        )
    return _STYLE % f"<table>{lines}</table>"


class Plots:
    """Charts over an episode's time, one of each agent's reward and one of measures."""

    def __init__(self, gui: viser.GuiApi, tab: viser.GuiTabHandle):
        self._gui, self._tab = gui, tab
        self._charts: dict[tuple[str, ...], viser.GuiUplotHandle] = {}
        self._drawn: Reading | None = None
        self._next = 0.0

    def refresh(self, session: Session) -> None:
        """Draw the episode that is read so far, unless it was drawn just now."""
        now, film, world = time.monotonic(), session.film, session.world
        last = film[-1].readings[world]
        if last is self._drawn or now < self._next:
            return
        self._drawn, self._next = last, now + _PAUSE
        readings = [frame.readings[world] for frame in film]
        rows = [_curves(reading) for reading in readings]
        keys = {(*chart, *curves): chart for chart, curves in rows[0].items()}
        if keys.keys() != self._charts.keys():
            for old in self._charts.values():
                old.remove()
            self._charts = {key: self._add(*key) for key in keys}
        times = np.array([reading.time for reading in readings])
        for key, chart in keys.items():
            # A start has no reward yet.
            first = int(chart[1] == _PER_STEP and len(rows) > 1)
            curves = np.array([list(row[chart].values()) for row in rows[first:]])
            self._charts[key].data = (times[first:], *np.ascontiguousarray(curves.T))

    def _add(self, title: str, unit: str, *names: str) -> viser.GuiUplotHandle:
        series: list[Any] = [
            {"label": name, "stroke": color, "width": 2, "points": {"show": False}}
            for name, color in zip(names, cycle(_COLORS), strict=False)
        ]
        axis: Any = {"labelSize": 18, "labelFont": "12px sans-serif", "size": 44}
        axis["ticks"] = {"show": False}
        # Some room below and above the curves.
        padded: Any = {end: {"pad": 0.1, "mode": 0} for end in ("min", "max")}
        axes: Any = {**axis, "label": "time, s", "size": 30}, {**axis, "label": unit}
        with self._tab:
            return self._gui.add_uplot(
                (np.zeros(1),) * (1 + len(names)),
                ({"label": "time, s"}, *series),
                title=title,
                scales={"x": {"time": False}, "y": {"range": padded}},
                axes=axes,
                height=160,  # pixels
                padding=(12, 12, 0, 0),
            )


def _curves(reading: Reading) -> dict[tuple[str, str], dict[str, float]]:
    """Return a control step's numbers by name, by the title and unit of a chart."""
    charts = {
        (f"reward of {agent}", _PER_STEP): {"total": sum(own.values()), **own}
        for agent, own in reading.rewards.items()
        if own
    }
    for name, value in reading.measures.items():
        unit = reading.units.get(name, "")
        if not isinstance(value, bool):
            chart = f"measured{unit and f' in {unit}'}", unit or "number"
            charts.setdefault(chart, {})[name] = value
    return charts
