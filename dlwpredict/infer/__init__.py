"""The estimator that calibration and diagnosis share.

One objective: −2 ln L of whitened residuals plus declared priors. One descent. One `best(model)`, remembered by what
the model is.

    recording   one recording beside its target: points that count, nuisances that are free, working pixels
    free        parameters as a flat vector: names for the user, numbers for the optimiser
    trace       one prediction with every state it passed through
    priors      what is known of every parameter and nuisance beforehand
    rows        which rows of the stacked residual belong to whom
    whitened    one recording in whitened space: residual, nuisance columns, registration
    objective   −2 ln L + priors: residual, derivatives, work
    descend     bounded, damped Gauss–Newton
    fitter      best(model)
    intervals   95 % intervals
    held_out    blocks and recordings left out
"""
