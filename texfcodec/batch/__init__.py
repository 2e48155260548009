"""Many tasks, each in processes of its own with capped time and memory: on this machine, or on a Dask cluster.

A task (tasks.py) is a list of commands that run in a folder of their own; children.py and child.py are the two sides of a process
that ends with its parent; local.py and cluster.py run many tasks and hand over each folder as it ends.
"""
