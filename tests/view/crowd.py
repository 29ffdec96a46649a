"""What a crowd on this machine gets from the page of a reduced model, and who asks beside it.

    python tests/view/crowd.py MODEL.rom.h5 [--clients 50] [--questions 40] [--idle 300] [--json]

One server on the loopback, one crowd after the other in a process of its own; an honest client
asks for states meanwhile, with a pause of 10 ms between them. Each crowd ends by its count.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import re
import select
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from urllib.parse import urlsplit

STATE = "state?p={p}&field=von_mises"
CURVES = "curves?p={p}&probe=0&family=1"
#: Crowds by name: what they ask below the token, and headers; a path from the root has no token
CROWDS = {
    "no token": ("/" + STATE, {}),
    "foreign Host": (STATE, {"Host": "example.org"}),
    "2,000-fold questions": (CURVES + "&of=" + ",".join(["0"] * 2000), {}),
    "not a number": (STATE.replace("{p}", "nan,1e999,x"), {}),
    "states": (STATE, {}),
    "curves, leaving": (CURVES, {}),
}


def crowd(address: str, name: str, clients: int, questions: int, values: str) -> Counter[str]:
    """Statuses that clients got, each with one connection at a time, as fast as they come."""
    url, got = urlsplit(address), Counter[str]()
    path, headers = CROWDS[name]
    path = path.replace("{p}", values)
    target = path if path.startswith("/") else url.path + path

    def ask() -> None:
        connection = http.client.HTTPConnection(url.netloc, timeout=60)
        for _ in range(questions):
            try:
                connection.request("GET", target, headers=headers)
                if name.endswith("leaving"):
                    connection.close()
                    got["left"] += 1
                    continue
                answer = connection.getresponse()
                answer.read()
                got[str(answer.status)] += 1
            except (OSError, http.client.HTTPException) as reason:
                got[type(reason).__name__] += 1
                connection.close()
        connection.close()

    threads = [threading.Thread(target=ask) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return got


def honest(address: str, values: str, goes_on: threading.Event, least: int) -> list[float]:
    """Times of answers [s]; where a connection has ended it asks again, as browsers do."""
    url, times = urlsplit(address), []
    connection = http.client.HTTPConnection(url.netloc, timeout=60)
    while goes_on.is_set() or len(times) < least:
        start = time.perf_counter()
        for attempt in range(2):
            try:
                connection.request("GET", url.path + STATE.replace("{p}", values))
                answer = connection.getresponse()
                answer.read()
                break
            except (OSError, http.client.HTTPException):
                connection.close()
                if attempt:
                    raise
        assert answer.status == 200, answer.status
        times.append(time.perf_counter() - start)
        time.sleep(0.01)
    connection.close()
    return times


def idle(address: str, count: int, seconds: float) -> Counter[str]:
    """How many of the connections that say nothing, or half a question, are ended."""
    url = urlsplit(address)
    sockets = []
    for number in range(count):
        sockets.append(socket.create_connection((url.hostname or "", url.port or 0), timeout=20))
        if number % 2:
            sockets[-1].sendall(b"GET / HTTP/1.1\r\nHost:")
    time.sleep(seconds)
    poll = select.poll()
    for one in sockets:
        poll.register(one, select.POLLIN)
    ended = 0
    for number, _ in poll.poll(0):
        one = next(s for s in sockets if s.fileno() == number)
        with contextlib.suppress(OSError):
            ended += one.recv(1) == b""
    for one in sockets:
        one.close()
    return Counter({"ended": ended, "open": count - ended})


def main() -> None:
    """Start the server, let the crowds come, print a table."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("model", type=Path)
    words.add_argument("--clients", type=int, default=50)
    words.add_argument("--questions", type=int, default=40, help="of each client")
    words.add_argument("--idle", type=int, default=300, help="idle connections")
    words.add_argument("--seconds", type=float, default=12.0, help="that they stay")
    words.add_argument("--values", default="0.4,0.1,30", help="of the parameters")
    words.add_argument("--json", action="store_true", help="print a record in place of a table")
    words.add_argument("--as", dest="name", help=argparse.SUPPRESS)
    words.add_argument("--at", help=argparse.SUPPRESS)
    options = words.parse_args()
    if options.name == "idle":
        print(json.dumps(idle(options.at, options.idle, options.seconds)))
        return
    if options.name:
        count = options.clients, options.questions
        print(json.dumps(crowd(options.at, options.name, *count, options.values)))
        return
    command = [sys.executable, "-m", "myork", "view", str(options.model), "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    found = re.search(r"http://\S+", server.stdout.readline())
    assert found, "the server did not start"
    record = {}
    try:
        for name in ("nobody", "idle", *CROWDS):
            record[name] = beside(found[0], name, options.values)
    finally:
        server.terminate()
        server.wait(60)
    if options.json:
        print(json.dumps(record))
        return
    print(f"{'crowd':<22}{'what it got':<28}{'honest client: answers':>23}  median ms   95 % ms")
    for name, one in record.items():
        got = ", ".join(f"{count} {what}" for what, count in one["got"].items())
        ms = "".join(f"{1e3 * one[key]:11.1f}" for key in ("median", "p95"))
        print(f"{name:<22}{got:<28}{one['answers']:>23}{ms}")


def beside(address: str, name: str, values: str) -> dict[str, object]:
    """What one crowd got, and times of an honest client beside it."""
    goes_on, times = threading.Event(), []
    goes_on.set()
    one = threading.Thread(target=lambda: times.extend(honest(address, values, goes_on, 50)))
    got = {}
    if name == "nobody":
        goes_on.clear()
        one.start()
    else:
        # the same words for the process that is the crowd
        words = [sys.executable, __file__, *sys.argv[1:], "--as", name, "--at", address]
        other = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        one.start()
        got = json.loads(other.communicate(timeout=300)[0])
        goes_on.clear()
    one.join()
    p95 = statistics.quantiles(times, n=20)[-1]
    return {"got": got, "answers": len(times), "median": statistics.median(times), "p95": p95}


if __name__ == "__main__":
    main()
