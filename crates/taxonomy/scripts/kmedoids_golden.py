"""Golden numbers for medoids_tests.rs: k-medoids by the reference package, by hand and rarely.

pip install kmedoids numpy   (GPL-3.0: only its numbers are used, none of it is shipped)
"""

import itertools

import kmedoids
import numpy as np

# Twenty-four points on a lattice without ties that matter: x = 37 i mod 101, y = 53 i mod 97.
points = np.array([((37 * i) % 101, (53 * i) % 97) for i in range(24)], dtype=float)
distances = np.abs(points[:, None] - points[None, :]).sum(-1)
for k in (2, 3, 4, 5):
    pam = kmedoids.pam(distances, k)
    least = min(
        distances[:, list(choice)].min(1).sum() for choice in itertools.combinations(range(24), k)
    )
    print(k, sorted(int(i) for i in pam.medoids), pam.loss, least)
