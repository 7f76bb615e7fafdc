"""An accuracy standard as a stranger would bring it: its table as the text of a TOML file."""

TEXT = """
id = "toy-standard"
kind = "scale"
title = "Toy standard of one class"
authority = "a stranger"
fraction_within_pec = 0.90

[[table]]
product = "planimetry"
component = "planimetry"
basis = "scale"
pec = { only = 0.5 }
ep = { only = 0.3 }
source = "invented"
second_hand = false
"""
