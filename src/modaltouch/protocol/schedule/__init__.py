"""Protocol + participant + seed -> Schedule of Blocks of Trials; pure.

``streams``  a random stream of its own for each purpose
``orders``   uniform draws among the orders that keep a limit on runs
``catches``  where catch trials stand among the others
``designs``  shuffled, blocked and Latin-square orders
``draw``     draw_schedule
"""

from modaltouch.protocol.schedule.draw import (
    Block,
    Schedule,
    Turn,
    draw_schedule,
    period_of_turns,
    recorded_turn,
    turn_of,
)
from modaltouch.protocol.schedule.orders import count_orders, draw_order
from modaltouch.protocol.schedule.streams import Stream, random_generator

__all__ = [
    "Block",
    "Schedule",
    "Stream",
    "Turn",
    "count_orders",
    "draw_order",
    "draw_schedule",
    "period_of_turns",
    "random_generator",
    "recorded_turn",
    "turn_of",
]
