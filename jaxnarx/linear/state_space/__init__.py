"""Linear state-space models, and networks with hidden states that begin as such a
model: products of states and inputs, regions of them, trained on the free run.
"""
