"""Measurements: rate_points.py and the rooms it walks through, and what makes tables of its results.

conditions -> jobs -> batch -> steps, each step a process of its own; methods/ holds our codec and its rivals, a file each.
"""
