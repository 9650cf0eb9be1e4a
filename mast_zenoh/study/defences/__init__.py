"""The kinds of studies of defences against adversaries.

    kinds      what all kinds of studies have; each kind is a module:
               matrix (every defence against every adversary), drift (how soon a displaced object is noticed),
               breakdown (with how many liars a defence breaks), field_matrix (the matrix of published and own methods),
               cooperation (how far a lie reaches, by where tracks are fused), driving_matrix (what attacks do to a
               driven car, with each defence)
    matrix_trial    what a matrix needs of one trial
    matrix_table    what a matrix is; matrix_tables, scoreboard (also published figures) and
                    matrix_figures show it

See docs/explanation-defences.md#run-the-studies.
"""
