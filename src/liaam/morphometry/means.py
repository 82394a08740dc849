"""Whether groups differ in the mean of a measure, such as a length or the centroid size."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

FEWEST = 2  # individuals of a group, to know how they vary


def p_of_means(values: np.ndarray, groups: Sequence[str], individuals: Sequence[str]) -> float:
    """Return the probability that the means of groups are as far apart, or farther, if they do not differ.

    It is that of Welch's t test for two groups, and of Alexander and Govern's (J. Educ. Stat. 19, 1994) for more. Both
    allow for groups that do not vary alike. Several specimens of one individual, such as both sides, are not
    independent: their mean counts once.

    Parameters
    ----------
    values : (m,) float
        Of each specimen; NaN where it is not known.
    groups, individuals : sequence of str
        Group of each, or empty, and the individual that it is a record of.

    Returns
    -------
    float
        NaN if there are not two groups of at least two individuals that vary.
    """
    from scipy.stats import alexandergovern, ttest_ind

    of_individuals: dict[tuple[str, str], list[float]] = defaultdict(list)
    for value, group, individual in zip(values.tolist(), groups, individuals, strict=True):
        if group and np.isfinite(value):
            of_individuals[group, individual].append(value)
    samples: dict[str, list[float]] = defaultdict(list)
    for (group, _), known in of_individuals.items():
        samples[group].append(float(np.mean(known)))
    large = [sample for sample in samples.values() if len(sample) >= FEWEST and np.ptp(sample) > 0.0]
    if len(large) < 2:
        return np.nan
    if len(large) == 2:
        return float(np.asarray(ttest_ind(*large, equal_var=False))[1])
    return float(alexandergovern(*large).pvalue)
