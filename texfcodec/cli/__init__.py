"""The command lines. Where the process is one of them, Ctrl-C is answered from here on, before anything heavy is imported."""

from . import interrupts

if interrupts.is_program():
    interrupts.install()
