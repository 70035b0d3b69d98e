"""The library behind the commands: the same verbs, on height maps in memory, one module per verb.

``import dlwpredict as dlw`` gives ``dlw.read``, ``dlw.predict`` ..., the names of ``dlwpredict.__all__``, and imports
what they need when the first of them is used. Lengths are µm; maps have shape (rows, cols) and travel with their grid.

Examples
--------
>>> import dlwpredict as dlw
>>> target = dlw.design("lens", size_um=12, pitch_um=0.5, margin_um=4)
>>> process = dlw.ParameterSet()
>>> printed = dlw.predict(target, process)
>>> better = dlw.precompensate(target, process)
>>> errors = [dlw.score(target, one, part_only=True).rmse_um for one in (printed, better.predicted)]
>>> bool(errors[1] < errors[0] / 2)
True
"""
