"""Values of launch files and URDF: arithmetic of constants, substitutions of arguments, and Python lists.

Nothing is executed: an expression is parsed, and numbers, names of known values, + - * / and pi are evaluated.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

_REFERENCE = re.compile(
    r"\$\((?:arg|var) ([\w.-]{1,100})\)|\$\{([^{}]{1,200})\}|\$\(eval ['\"]?([^()'\"]{1,200})['\"]?\)|\$(\w{1,100})"
)
_OPERATORS: Mapping[type, Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip
_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "float": float, "radians": math.radians, "deg2rad": math.radians, "degrees": math.degrees,
}  # fmt: skip
_TRUTH = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
_CONDITIONS = {"IfCondition": True, "UnlessCondition": False}
_DEEPEST, _MAX_PYTHON = 8, 1 << 20


def substituted(text: str, values: Mapping[str, str]) -> str:
    """Return a text with the values of `$(arg x)`, `$(var x)`, `$x`, `${x}`, `${arithmetic of x}` and `$(eval ...)`.

    What is unknown remains as it is.
    """

    def value_of(match: re.Match[str]) -> str:
        expression = match[2] or match[3]
        name = match[1] or expression or match[4]
        return values[name] if name in values else (expression and arithmetic(expression, values)) or match[0]

    return _REFERENCE.sub(value_of, text) if "$" in text else text


def holds(text: str, wanted: bool) -> bool | None:
    """Return whether the text of a condition is the `wanted` truth value, or None if it is not known."""
    word = text.strip().lower()
    return None if word not in _TRUTH else _TRUTH[word] is wanted


def arithmetic(text: str, values: Mapping[str, str]) -> str | None:
    """Return the number of an expression of numbers, names and pi as text, or None."""
    try:
        node = _parsed(text.strip(), "eval").body
        return repr(_number(node, {name: ast.Constant(value) for name, value in values.items()}))
    except (ValueError, TypeError, SyntaxError, ArithmeticError, RecursionError, MemoryError):
        return None


class PythonFile:
    """A Python file whose constants and launch arguments are known by name."""

    def __init__(self, tree: ast.AST) -> None:
        self.calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        nodes = list(ast.walk(tree))
        assigned = [(target, node.value) for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
        assigned += [(node.target, node.value) for node in nodes if isinstance(node, ast.AnnAssign) and node.value]
        for target, value in assigned:
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
                assigned += zip(target.elts, value.elts, strict=True)
        targets = [(target.id, value) for target, value in assigned if isinstance(target, ast.Name)]
        # Names of loops and parameters, and those that are assigned twice, have no single value.
        names = [node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        names += [node.arg for node in nodes if isinstance(node, ast.arg)]
        self._names = {name: value for name, value in targets if names.count(name) == 1}
        self._arguments: dict[str, ast.expr] = {}
        for call in self.calls:
            keywords = {word.arg: word.value for word in call.keywords}
            first = call.args[0] if call.args else keywords.get("name")
            default = keywords.get("default_value")
            if _called(call) == "DeclareLaunchArgument" and isinstance(first, ast.Constant) and default is not None:
                self._arguments[str(first.value)] = default

    @classmethod
    def of(cls, text: str) -> PythonFile:
        """Return the parsed file; one without calls for a text that is not Python or longer than 1 MiB."""
        try:
            return cls(_parsed(text if len(text) <= _MAX_PYTHON else ""))
        except (ValueError, SyntaxError, RecursionError, MemoryError):
            return cls(ast.Module([], []))

    def words(self, node: ast.expr | None, level: int = 0) -> list[str]:
        """Return the texts of a list: literal, added, split or assigned to a name; unknown texts are `$(code)`."""
        if node is None or level > _DEEPEST:
            return []
        if isinstance(node, ast.Name) and node.id in self._names:
            return self.words(self._names[node.id], level + 1)
        if isinstance(node, ast.List | ast.Tuple):
            return [word for item in node.elts for word in self._item(item, level + 1)]
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return [*self.words(node.left, level + 1), *self.words(node.right, level + 1)]
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "split":
            return self.text(node.func.value).split()
        return self.text(node).split()

    def _item(self, node: ast.expr, level: int) -> list[str]:
        return self.words(node.value, level) if isinstance(node, ast.Starred) else [self.text(node)]

    def condition(self, node: ast.expr | None) -> tuple[str, bool | None]:
        """Return the text of the condition of a node, and whether it holds; None: unknown."""
        if node is None:
            return "", True
        wanted = _CONDITIONS.get(_called(node)) if isinstance(node, ast.Call) and node.args else None
        state = holds(self.text(node.args[0]), wanted) if isinstance(node, ast.Call) and wanted is not None else None
        return ast.unparse(node)[:100], state

    def text(self, node: ast.expr | None, level: int = 0) -> str:
        """Return the text of a constant, a number, a name or a launch argument, else `$(code)`."""
        if isinstance(node, ast.Constant):
            return str(node.value)
        if node is None or level > _DEEPEST:
            return "$(?)"
        if isinstance(node, ast.Name) and node.id in self._names:
            return self.text(self._names[node.id], level + 1)
        if isinstance(node, ast.JoinedStr):
            return "".join(self.text(part, level + 1) for part in node.values)
        if isinstance(node, ast.FormattedValue):
            return self.text(node.value, level + 1)
        if isinstance(node, ast.List) and len(node.elts) == 1:
            return self.text(node.elts[0], level + 1)
        if isinstance(node, ast.Call):
            keywords = {word.arg: word.value for word in node.keywords}
            if _called(node) in ("str", "TextSubstitution") and (node.args or "text" in keywords):
                return self.text(node.args[0] if node.args else keywords["text"], level + 1)
            if isinstance(node.func, ast.Attribute) and node.func.attr == "perform":
                return self.text(node.func.value, level + 1)
            if _called(node) == "LaunchConfiguration":
                name = self.text(node.args[0] if node.args else keywords.get("variable_name"), level + 1)
                return self.text(self._arguments.get(name, keywords.get("default")), level + 1).replace("?", name)
        try:
            return repr(_number(node, self._names))
        except (ValueError, TypeError, ArithmeticError, RecursionError):
            return f"$({ast.unparse(node)[:60]})"


def _number(node: ast.expr, names: Mapping[str, ast.expr], level: int = 0) -> float:
    """Return the value of an arithmetic expression; raises ValueError for others."""
    if level > 4 * _DEEPEST:
        raise ValueError("nested too deeply")
    if isinstance(node, ast.Constant) and not isinstance(node.value, bool | complex | bytes):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name) and node.id in names:
        return _number(names[node.id], names, level + 1)
    if (isinstance(node, ast.Name) and node.id in ("pi", "M_PI")) or (
        isinstance(node, ast.Attribute) and node.attr == "pi"
    ):
        return math.pi
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _number(node.operand, names, level + 1)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_number(node.left, names, level + 1), _number(node.right, names, level + 1))
    if isinstance(node, ast.Call) and len(node.args) == 1 and _called(node) in _FUNCTIONS:
        return _FUNCTIONS[_called(node)](_number(node.args[0], names, level + 1))
    raise ValueError("not arithmetic")


def _parsed(text: str, mode: str = "exec") -> Any:
    """Return the syntax tree of a text without the warnings of Python's parser about it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ast.parse(text, mode=mode)


def _called(call: ast.Call) -> str:
    """Return the name of a function without its module."""
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
