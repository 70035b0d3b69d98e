"""Diagnosis: what the recordings say about physics that the model lacks.

`evidence` brings residuals, derivatives and nuisances into whitened space; `noise_fit` estimates the noise; `fit` is
maximum likelihood there; `candidates` and `screen` score every named effect; `attempts` refits them, `judge` weighs
what that brings, `select` chooses; `freeform` holds the nameless competitors.
"""
