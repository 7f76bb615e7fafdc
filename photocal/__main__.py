"""`python -m photocal`: the command, where no script is on the path."""

from photocal.commands.cli import main

main()
