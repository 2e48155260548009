"""Tables and pages of what rate_points.py has measured: a module each with page(), called by collect.py --table NAME."""
