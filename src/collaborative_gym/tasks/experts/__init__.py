"""The scripted experts of the tasks, a file each.

A task's class takes `expert` and `styled` of its file as its methods, `STYLES` as its
`styles`.
"""
