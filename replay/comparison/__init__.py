"""Filter variants over one log: runs, alignment of the truth, scores, intervals.

In: a `Log`. Out: a `Comparison`, and the results that tables and pages are made of. Below: `base`,
`estimator`.
"""
