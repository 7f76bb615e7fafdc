"""`python -m acquire`: the command, where no script is on the path."""

from acquire.commands.cli import main

main()
