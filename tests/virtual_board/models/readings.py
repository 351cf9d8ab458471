"""Facts that the manuals leave open, each with a first and a second reading; only a test on hardware can decide between
them.

The models follow the first reading of each fact; with `--reading NAME` they follow the second one. The same cases must
pass: the firmware must not depend on the reading.
"""

READINGS = {
    "compare-on-count": "a compare value that is written where the counter is matches at once; first reading: the counter has to arrive there (TIMx_CCRx,"
    " RM0383 13.4.13 and RM0390 17.4.13, and the section on output compare mode say neither)",
    "flags-by-dma": "a read of USART_DR by DMA clears PE, FE, NE, ORE and IDLE, whoever reads USART_SR; first reading: only software that has read SR"
    " before it reads DR (USART_SR, RM0383 19.6.1, RM0390 25.6.1: a software sequence)",
    "counted-at-fetch": "NDTR of a stream from memory goes down when a word is fetched, one before it is asked for; first reading: when it has been written"
    " (DMA_SxNDTR, RM0383 9.5.6, RM0390 9.5.6: decrements after each DMA transfer)",
    "quick-trigger": "TIM1 counts 1 clock after the compare event of TIM5; first reading: after 4 (RM0383 chapter 13, RM0390 chapter 17, timer"
    " synchronization: a delay by resynchronization, and no figure)",
    "slow-trigger": "the same after 8 clocks",
}

_chosen = set()


def choose(name):
    """Makes the models follow the second reading of a fact from now on."""
    if name not in READINGS:
        raise SystemExit(f"there is no reading {name}; there are {', '.join(READINGS)}")
    _chosen.add(name)


def is_chosen(name):
    """Returns whether the models follow the second reading of a fact."""
    assert name in READINGS, name
    return name in _chosen


def forget():
    """Restores the first readings."""
    _chosen.clear()
