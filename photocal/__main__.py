"""`python -m photocal`: the command, where no script is on the path."""

from photocal.cli import main

main()
