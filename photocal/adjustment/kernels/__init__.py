"""The loops over all rays.

Each pass visits the object points one after the other, evaluates the rays of a point with their
derivatives, and is done with the point: nothing of the size of the design matrix is ever stored
(Brown 1976; Triggs et al. 2000, section 6). Points are worked on in pieces that lie
close together; threads share the pieces, and sums over pieces are taken in their order.
"""
