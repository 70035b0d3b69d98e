# Settings of this folder: take the # away from what you need. `make help` lists all of them; what is set for a step can
# be set for one file of it: CONVERT_lens--monday = --pitch-um 100nm

# Values and bounds that the fit begins with, and how the printer slices.
START = start.yaml

# Recordings that are text, in metres and without their pitch:
# CONVERT = --pitch-um 312.5nm --z-scale 1e6

# Targets that do not say their pitch:
# CONVERT_TARGET = --pitch-um 0.4

# A microscope whose lateral scale can be trusted:
# ALIGN = --distortion rigid

# Where the diagnosis cannot tell whether printer or microscope is wrong, `make` stops; say which:
# CORRECT = --undecided print
