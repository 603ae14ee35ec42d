"""One method for every machine: a linear model without its nuisances, scores, steps, alternatives, cross-validation,
lack of fit.
"""
