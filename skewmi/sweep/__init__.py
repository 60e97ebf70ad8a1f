"""Many trainings from one file: seeds x configurations x tasks, resumable, on one machine or many.

`tables` is what others may read; nothing here knows a task, an environment or the command line.
"""
