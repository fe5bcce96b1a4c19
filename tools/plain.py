"""Size and density of the code per folder: `python tools/plain.py [FOLDER...]`.

Tokens and lines of code are without comments and docstrings; long is the share of lines over 100 columns.
Tricks per 1,000 lines are unrelated assignments in one, assignments from a generator, a list or text times a condition,
a comprehension in a comprehension, `for x in [value]`, and a conditional expression in a conditional expression.
"""

import ast
import io
import sys
import tokenize
from pathlib import Path

LAYOUT = ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENCODING", "ENDMARKER")
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def docstring_lines(tree):
    nodes = [node for node in ast.walk(tree) if isinstance(node, DOCUMENTED)]
    documented = [node for node in nodes if ast.get_docstring(node, clean=False) is not None]
    spans = [range(node.body[0].lineno, node.body[0].end_lineno + 1) for node in documented]
    return set().union(*spans)


def contains(node, kinds):
    return any(isinstance(inner, kinds) for inner in ast.walk(node) if inner is not node)


def is_sequence(node):
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str)
    return isinstance(node, (ast.List, ast.Tuple, ast.JoinedStr))


def is_condition(node):
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "bool"
    if isinstance(node, ast.Name):
        return node.id.startswith(("is_", "has_", "with_"))
    is_negation = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
    return is_negation or isinstance(node, (ast.Compare, ast.BoolOp))


def is_packed(value):
    """True for unrelated values: not all names, constants and attributes, nor all calls of one function."""
    if not isinstance(value, ast.Tuple):
        return isinstance(value, ast.GeneratorExp)
    if all(isinstance(item, (ast.Name, ast.Constant, ast.Attribute)) for item in value.elts):
        return False
    is_all_calls = all(isinstance(item, ast.Call) for item in value.elts)
    return not is_all_calls or len({ast.unparse(item.func) for item in value.elts}) > 1


def count_tricks(node):
    if isinstance(node, ast.Assign):
        return int(isinstance(node.targets[0], ast.Tuple) and is_packed(node.value))
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        sides = ((node.left, node.right), (node.right, node.left))
        return sum(is_sequence(a) and is_condition(b) for a, b in sides)
    if isinstance(node, COMPREHENSIONS):
        lists = [part.iter for part in node.generators if isinstance(part.iter, ast.List)]
        return contains(node, COMPREHENSIONS) + sum(len(values.elts) == 1 for values in lists)
    return int(isinstance(node, ast.IfExp) and contains(node, ast.IfExp))


def measure(content):
    """Tokens, lines, tricks and long lines of a module."""
    tree = ast.parse(content)
    docstrings = docstring_lines(tree)
    tokens = list(tokenize.tokenize(io.BytesIO(content).readline))
    tokens = [token for token in tokens if tokenize.tok_name[token.type] not in LAYOUT]
    tokens = [token for token in tokens if token.start[0] not in docstrings]
    lines = set().union(*(range(token.start[0], token.end[0] + 1) for token in tokens))
    text = content.decode().splitlines()
    n_long = sum(len(text[line - 1]) > 100 for line in lines)
    return len(tokens), len(lines), sum(map(count_tricks, ast.walk(tree))), n_long


def main(folders):
    print(f"{'folder':32} {'tokens':>8} {'lines':>7} {'per line':>8} {'tricks':>7} {'long':>6}")
    for folder in folders:
        modules = [measure(path.read_bytes()) for path in Path(folder).rglob("*.py")]
        tokens, lines, tricks, n_long = map(sum, zip(*modules, strict=True))
        cells = f"{tokens:8,} {lines:7,} {tokens / lines:8.1f} {1000 * tricks / lines:7.1f}"
        print(f"{folder:32} {cells} {n_long / lines:6.1%}")


if __name__ == "__main__":
    main(sys.argv[1:] or ["pipeline", "stages", "schemas", "tests"])
