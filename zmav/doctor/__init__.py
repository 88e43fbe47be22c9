"""What is wrong and what to do about it: the rules that ``zmav top``, the gateway's page and ``zmav doctor`` share.

:mod:`zmav.doctor.facts` is what is known of a vehicle, :mod:`zmav.doctor.rules` judges it.
"""
