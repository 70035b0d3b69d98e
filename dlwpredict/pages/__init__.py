"""Reports for the eye: a diagnosis as one self-contained HTML page and as lines for the terminal.

`words` says numbers, `pictures` draws maps and profiles, `diagnosis` puts the page together, `terminal` the lines.
"""
