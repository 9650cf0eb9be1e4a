"""Every defence against every adversary.

cells       the cells of the matrix as configurations of a study
trial       the lies of one run, and which of them were detected
traces      the trust of one run over time
records     what the matrix needs of one trial
pooled      numbers over the trials of a cell or of a defence
collection  the matrix: a row for each cell, a summary for each defence
"""
