"""How soon a displaced object is noticed, next to the least delay that is possible.

cell        the configurations
trial       the displaced objects of one run
episodes    how long displaced objects were in view before their liar was suspended
floor       the least delay with which a displaced object can be noticed
collection  delays of all trials next to the floor
"""
