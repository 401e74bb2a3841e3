"""How good a loop can be at all: what no linear controller goes below under the same bounds.

It needs cvxpy and Clarabel, which are the extra ``limit`` of this package.
"""
