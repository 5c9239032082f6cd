"""Mutation testing: each mutant is the code with one small mistake, which a test must detect.

    python tests/mutation.py [--each 15] [--only record/chain.py] [--match TEXT] [--out results/benchmarks/mutants.json]

For every module in ``mutation.toml`` this lists all mutants (a comparison flipped, a sum made a difference, a constant
changed, a condition negated, nothing returned, a statement removed), takes the first `--each` by a seeded hash of what
they change, so that an edit elsewhere leaves the sample as it is, and runs the tests listed there on each. A mutant
that no test detects survives, and fails the run unless ``mutation.toml`` argues that it breaks no promise. No file
changes: each mutant exists in a forked child only. Programs that a test starts are not mutated. POSIX only.
"""

from __future__ import annotations

import argparse
import ast
import copy
import gc
import hashlib
import json
import math
import os
import sys
import tempfile
import tomllib
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from inspect import CO_OPTIMIZED
from pathlib import Path
from threading import Timer
from types import CodeType, FunctionType
from typing import Any

import hypothesis
import pytest

PHASES = (hypothesis.Phase.explicit, hypothesis.Phase.generate)  # the smallest example does not matter here
ROOT = Path(__file__).parents[1]
SEED = "modaltouch"
LIMIT = 5.0  # CPU seconds a mutant may take beyond twice the time of the unchanged tests
LONGEST = 900.0  # seconds, as a mutant may also wait for ever where no limit of a test applies
OPTIONS = """-x -q -p no:cacheprovider -p no:xdist --hypothesis-profile=mutation --timeout=90
 -W ignore::pytest.PytestAssertRewriteWarning --basetemp"""
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.MatMult: ast.Mult,
}  # fmt: skip


def variants(node: ast.AST, parent: ast.AST, field: str) -> Iterator[ast.AST]:
    """Yield the replacements of a node."""
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            swapped = copy.deepcopy(node)
            swapped.ops[place] = SWAPS[type(operator)]()
            yield swapped
    elif isinstance(node, (ast.BinOp, ast.BoolOp, ast.AugAssign)) and type(node.op) in SWAPS:
        swapped = copy.deepcopy(node)
        swapped.op = SWAPS[type(node.op)]()
        yield swapped
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(2 * node.value or 1.0)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        if isinstance(parent, (ast.Dict, ast.Subscript, ast.Compare)) and " " not in node.value:
            yield ast.Constant(node.value + "X")
    elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != "None":
        yield ast.Return(ast.Constant(None))
    if isinstance(node, (ast.Raise, ast.Continue, ast.Break, ast.AugAssign, ast.Delete)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield ast.Pass()
    if field in {"test", "ifs"} and not isinstance(parent, ast.Assert):
        yield ast.UnaryOp(ast.Not(), node)


def sites(node: ast.AST, where: str = "", line: str = "") -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield name and action of every mistake that can be made below a node."""
    for field, value in ast.iter_fields(node):
        if field in {"annotation", "returns", "decorator_list"} or isinstance(node, ast.JoinedStr):
            continue  # types, and texts of messages
        inside = where
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and field == "body":
            inside = f"{where}.{node.name}".removeprefix(".")
        for place, child in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(child, ast.AST):
                continue
            text = ast.unparse(child).split("\n")[0] if isinstance(child, ast.stmt) else line
            for new in variants(child, node, field):
                what = text if isinstance(child, ast.stmt) else f"{text}\0{ast.unparse(child)}"
                yield f"{inside}: {what} -> {ast.unparse(new)}", partial(_put, node, field, place, new)
            yield from sites(child, inside, text)


def _put(node: ast.AST, field: str, place: int, new: ast.AST) -> None:
    value = getattr(node, field)
    if isinstance(value, list):
        value[place] = new
    else:
        setattr(node, field, new)


def mutants(tree: ast.Module) -> dict[str, Callable[[], None]]:
    """Return every mistake that can be made in a module, by name, in the order of the sample."""
    seen: Counter[str] = Counter()
    short: Counter[str] = Counter()
    found = []
    for said, deed in sites(tree):
        place, _, what = said.partition("\0")
        if not what:
            place, _, what = said.rpartition(" -> ")
        name = f"{place[:100]} | {what}" if "\0" in said else f"{place[:100]} -> {what}"
        whole = said.replace("\0", " | ")
        seen[whole] += 1
        short[name] += 1
        found.append((_numbered(SEED + whole, seen[whole]), _numbered(name, short[name]), deed))
    return {name: deed for _, name, deed in sorted(found, key=lambda item: hashlib.sha256(item[0].encode()).digest())}


def _numbered(name: str, number: int) -> str:
    return f"{name} ({number})" if number > 1 else name


def functions(code: CodeType) -> dict[tuple[str, int], CodeType]:
    """Return the code of every function and method of a module, by qualified name and line."""
    inner = [item for item in code.co_consts if isinstance(item, CodeType) and "<" not in item.co_name]
    own = {(item.co_qualname, item.co_firstlineno): item for item in inner if item.co_flags & CO_OPTIMIZED}
    return own | {
        key: item for body in inner if not body.co_flags & CO_OPTIMIZED for key, item in functions(body).items()
    }


class Part(SourceFileLoader):
    """A module with its tests, and the child processes that try them on one mutant each."""

    def __init__(self, module: str, tests: list[str], folder: Path) -> None:
        super().__init__(f"modaltouch.{module[:-3].replace('/', '.')}", str(ROOT / "src" / "modaltouch" / module))
        self.source, self.log, self.limit = Path(self.path).read_text(encoding="utf-8"), folder / "log", LIMIT
        self.arguments = [*OPTIONS.split(), str(folder / "tmp"), *(str(ROOT / "tests" / test) for test in tests)]
        self.names = list(mutants(ast.parse(self.source)))
        self.spoilt, self.asked, self.verdicts = "", [""], folder / "verdicts.json"

    def compiled(self, mutant: str) -> CodeType:
        """Return the module's code with one mutant, or unchanged."""
        tree = ast.parse(self.source)
        if mutant:
            mutants(tree)[mutant]()
        return compile(ast.fix_missing_locations(tree), self.path, "exec")

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find this one module before the interpreter's own finders do."""
        return spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname: str) -> CodeType:
        """Return the code to import."""
        return self.compiled(self.spoilt)

    def test(self) -> int:
        """Run the tests in this process and return the exit status of pytest."""
        with self.log.open("wb") as words:
            os.dup2(words.fileno(), 1)
            os.dup2(words.fileno(), 2)
        sys.meta_path.insert(0, self)
        if self.spoilt:
            limited(self.limit + LIMIT)
        return pytest.main(self.arguments, plugins=[self])

    def pytest_runtestloop(self) -> bool | None:
        """Run the collected tests once for every requested mutant, each time in a child."""
        import_module(self.name)  # otherwise a test may import it first, in the child, without the mutant
        plain, found = functions(self.compiled("")), {}
        for name in self.asked if not self.spoilt else ():
            fresh = functions(self.compiled(name))
            if name and fresh == plain:
                continue  # the import itself is mutated: not in a process that has imported already
            if not (child := os.fork()):
                limited(self.limit if name else 3600)
                gc.unfreeze()  # the suite freezes what is collected; without this only the rest would be mutated
                for item in gc.get_objects():
                    if isinstance(item, FunctionType) and item.__module__ == self.name:
                        item.__code__ = fresh.get((item.__qualname__, item.__code__.co_firstlineno), item.__code__)
                return None  # pytest then runs the tests
            found[name], taken = wait(child)
            if not name:
                self.limit = LIMIT + 2 * taken
                if found[name] != "passed":
                    break
        self.verdicts.write_text(json.dumps([self.limit, found]), encoding="utf-8")
        return None if self.spoilt else True

    def judge(self, names: list[str]) -> dict[str, str]:
        """Return passed or failed for each mutant, and for the unchanged module."""
        self.asked = ["", *names]
        wait(forked(self.test))
        self.limit, found = json.loads(self.verdicts.read_text(encoding="utf-8"))
        if found[""] != "passed":
            sys.exit(f"{self.name}: the tests fail without any mutant:\n{self.log.read_text(encoding='utf-8')}")
        for self.spoilt in names:
            if self.spoilt not in found:
                found[self.spoilt], _ = wait(forked(self.test))
        return found


def forked(work: Callable[[], int]) -> int:
    """Return the process id of a child that does the work and ends with its status."""
    child = os.fork()
    if child:
        return child
    status = 3
    try:
        status = work()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(status)


def wait(child: int) -> tuple[str, float]:
    """Return how a child ended, passed or failed, and the CPU time it took [s]."""
    _, status, usage = os.wait4(child, 0)
    return "failed" if status else "passed", usage.ru_utime + usage.ru_stime


def limited(seconds: float) -> None:
    """End this process once it has computed that long, or waited for `LONGEST`; a mutant may never return."""
    from resource import RLIMIT_CPU, setrlimit  # not on Windows, where pytest still searches this file for doctests

    waited = Timer(LONGEST, os._exit, (3,))
    waited.daemon = True
    waited.start()
    setrlimit(RLIMIT_CPU, (math.ceil(seconds), math.ceil(seconds)))


def examine(module: str, plan: dict[str, Any], each: int, match: str, folder: Path) -> dict[str, int]:
    """Try a sample of a module's mutants, print the survivors and return the counts."""
    part, argued = Part(module, plan["tests"], folder), plan.get("argued", {})
    for name in argued.keys() - set(part.names):
        print(f"{module}: argued, but no mutant any more: {name}")
    names = [name for name in part.names[:each] if match in name]
    verdicts = part.judge(names)
    counts = {"mutants": len(names), "killed": 0, "survived_argued": 0, "survived": 0}
    for name in names:
        killed = verdicts[name] != "passed"
        verdict = "killed" if killed else "survived_argued" if name in argued else "survived"
        counts[verdict] += 1
        if verdict == "survived" or (killed and name in argued):
            print(f"{module}: {verdict}: {name}")
    print(f"{module}: {counts}", flush=True)
    return counts


def main() -> int:
    """Examine the requested modules, write the counts and fail if a survivor is not argued."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=15, help="mutants of each module (default 15)")
    parser.add_argument("--only", nargs="*", help="these modules alone, such as record/chain.py")
    parser.add_argument("--match", default="", help="the mutants alone whose name holds this text")
    parser.add_argument("--out", type=Path, help="JSON file for the counts")
    given = parser.parse_args()
    os.nice(15)
    os.chdir(ROOT)  # the tests expect this working directory
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for package in ("numpy", "pandas", "scipy.stats", "scipy.optimize", "scipy.signal", "pydantic", "ruamel.yaml"):
        import_module(package)  # once, for all children
    hypothesis.settings.register_profile("mutation", database=None, derandomize=True, deadline=None, phases=PHASES)
    plan = tomllib.loads((ROOT / "tests" / "mutation.toml").read_text(encoding="utf-8"))
    if unknown := set(given.only or ()) - plan.keys():
        parser.error(f"{', '.join(sorted(unknown))}: no module of tests/mutation.toml, so nothing would be examined")
    results = json.loads(given.out.read_text(encoding="utf-8")) if given.out and given.out.exists() else {}
    clean = True
    for module, part in plan.items():
        if not given.only or module in given.only:
            with tempfile.TemporaryDirectory() as folder:
                counts = examine(module, part, given.each, given.match, Path(folder))
            clean &= not counts["survived"]
            results[module] = counts
            if given.out:
                given.out.write_text(json.dumps(results, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return 0 if clean else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
