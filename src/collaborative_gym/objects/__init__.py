"""The things in the worlds: functions that return a model of one."""
