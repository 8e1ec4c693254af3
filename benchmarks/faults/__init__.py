"""Faults on purpose: a campaign of hostile messages, bad links and dying processes.

Every case has a name and a seed, so that it can be repeated alone. What a case shows is compared
with the promises in `promises.py`. No promise is about time.
"""
