"""`p2o data topics`: list the topics of a ROS bag."""

from __future__ import annotations

import click
from p2o.cli.json_output import json_option, print_json
from p2o.reading import printable


@click.command("topics")
@click.argument("path", metavar="BAG")
@json_option
def command(path: str, as_json: bool) -> int:
    """Print the topics of a ROS bag, and the topics that the data set `ros` selects automatically."""
    from dataclasses import asdict

    from p2o_datasets.bags.bag import Bag
    from p2o_datasets.bags.overview import chosen_words, overview

    bag = Bag(path.removeprefix("ros:"))
    topics, chosen = overview(bag), chosen_words(bag)
    if as_json:
        print_json({"topics": [asdict(topic) for topic in topics], "ros": chosen})
        return 0
    rows: list[tuple[str, ...]] = [("topic", "type", "count", "Hz", "frame", "first s", "last s", "")]
    for topic in topics:
        times = ("" if value is None else f"{value:.3f}" for value in (topic.first_s, topic.last_s))
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:g}"
        rows.append((topic.name, topic.type, str(topic.count), rate, topic.frame_id or "", *times, topic.details))
    rows = [tuple(printable(cell, 200) for cell in row) for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, (*widths, 0), strict=True))
        click.echo("  ".join(cells).rstrip())
    click.echo()
    for what, topic_name in chosen.items():
        click.echo(f"{what}: {printable(topic_name)}")
    return 0
