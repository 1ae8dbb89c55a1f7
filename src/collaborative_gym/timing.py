"""The time steps that physics, control and servos share."""

SIM_DT = 0.01
"""Physics time step in s, stable with the stiff servos of all arms."""

CONTROL_DT = 0.1
"""Time between actions, in s."""

SUBSTEPS = round(CONTROL_DT / SIM_DT)
"""Physics steps between actions."""

MAX_CHANGE = 0.25
"""Greatest change of a joint angle that one action can ask for, in rad."""
