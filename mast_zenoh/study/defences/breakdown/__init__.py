"""With how many liars a defence breaks, next to the share at which honest viewers lose their majority.

cell        the configurations
trial       what decides whether the defence broke in one run
crossing    the share of liars at which a curve reaches one half
collection  broken trials and breakdown points
"""
