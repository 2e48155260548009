"""The command lines. If the process is one of them, Ctrl-C is handled from here on, before anything heavy is imported."""

from . import interrupts

if interrupts.is_program():
    interrupts.install()
