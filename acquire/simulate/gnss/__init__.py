"""Satellites and receivers that never were: what a pair of GNSS receivers would have put on the wire.

GPS and Galileo on two frequencies each. Modelled are broadcast orbits and clocks with relativity and group
delays, light time and the earth's rotation, ionosphere, troposphere, receiver clocks, multipath, noise,
integer and half cycle ambiguities and slips. Left out is what a short baseline does not show: tides, phase
wind-up and the variations of the antennas' phase centres; Dopplers are without the atmosphere's drift, some
millimetres per second.
"""
