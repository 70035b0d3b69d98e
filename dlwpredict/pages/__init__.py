"""Reports for the eye: a diagnosis or a run folder as one self-contained HTML page, a diagnosis also as terminal lines.

`diagnosis` and `report` put the pages together, `pictures` and `report_pictures` draw, `relief` feeds the view that can
be turned, `run_folder` and `records` read, `require` checks, `words` says numbers, `templates` holds the look that all
pages share.
"""
