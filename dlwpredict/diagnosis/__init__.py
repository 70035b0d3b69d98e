"""Diagnosis: what the recordings say about physics that the model lacks.

`run` is the loop; `library` holds what each named effect would change; `posterior` and `search` weigh sets of them;
`structure` tests what has no name; `answer` says it; `policy` has every constant that decides.
"""
