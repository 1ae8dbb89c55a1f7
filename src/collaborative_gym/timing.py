"""The time steps that physics, control and servos share."""

SIM_DT = 0.01
"""Physics time step in s, stable with the stiff servos of all arms."""

CONTROL_DT = 0.1
"""Time between actions, in s."""

SUBSTEPS = round(CONTROL_DT / SIM_DT)
"""Physics steps between actions."""

MAX_CHANGE = 0.25
"""Greatest change of a joint angle that one action can ask for, in rad."""

KEPT_LOAD = 0.7
"""Share of the torque against a load that a servo keeps from one control step to the
next, our choice. Kept whole, what two arms exert against each other on a thing would
stay until an action happened to undo it, though nobody sees it in the joint angles.
So it halves in 0.2 s, and an arm has to act to hold a weight that it carries."""
