# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The documentation: its examples run and print what is shown, and its links have targets."""

import ast
import doctest
from functools import cache
from pydoc import locate
import re
import subprocess
import sys
from types import ModuleType

from conftest import NAME, PACKAGE, ROOT
import pytest
import rigid_body_ros

PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
_FENCE = re.compile(r'^(```+|~~~+)(\w*)[^\n]*\n(.*?)^\1[`~]*[ ]*$', re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r'(`+)(?:(?!\n\n).)*?\1', re.DOTALL)
_LINK = re.compile(r'\]\(\s*([^)\s]+)[^)]*\)|^\[[^\]]+\]:\s*(\S+)|\b(?:src|href)="([^"]+)"',
                   re.MULTILINE)
_FILE = re.compile(r'`([\w-]+(?:/[\w-]+)+\.py)`')
_DOTTED = re.compile(r'`(?!\w+\.py`)(\w+(?:\.\w+)+)\b(?![./])')
_HEADING = re.compile(r'^#{1,6} +(.*?) *#*$', re.MULTILINE)
#: Matches something that a page loads from the network.
_REMOTE = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="(?:https?:)?//')
_EXTERNAL = re.compile(r'[a-z][a-z+.-]*:')


def blocks(page):
    """Return the fenced blocks of Python, each with the number of lines before it."""
    text = page.read_text(encoding='utf-8')
    return [(match[3], text.count('\n', 0, match.start(3))) for match in _FENCE.finditer(text)
            if match[2] in ('python', 'pycon')]


@cache
def run(page):
    """Run the code of a page as a reader would; return its names, and what does not match."""
    names, said = {'__name__': '__main__'}, []
    # The page may wrap long messages.
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    for code, before in blocks(page):
        if '>>>' in code:
            examples = doctest.DocTestParser().get_doctest(code, names, page.name, page, before)
            runner.run(examples, out=said.append, clear_globs=False)
            names = examples.globs
        else:
            exec(compile('\n' * before + code, page, 'exec'), names)
    return names, said


@pytest.mark.slow
@pytest.mark.parametrize('page', [page for page in PAGES if blocks(page)], ids=lambda p: p.name)
def test_the_code_of_a_page_runs_and_prints_what_it_says(page):
    _, said = run(page)
    assert not said, ''.join(said)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_no_example_stands_where_it_is_not_run(page):
    shown = re.findall(r'^\s*>>> ', page.read_text(encoding='utf-8'), re.MULTILINE)
    run = [line for code, _ in blocks(page) for line in code.splitlines()
           if line.lstrip().startswith('>>> ')]
    assert len(shown) == len(run)


@pytest.mark.slow
@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_the_names_in_the_text_of_a_page_are_there(page):
    # Code within sentences does not run; its names are looked up like those in the examples.
    names, _ = run(page)
    text = _FENCE.sub('', page.read_text(encoding='utf-8'))
    assert [name for name in _DOTTED.findall(text) if not exists(name, names)] == []


@pytest.mark.parametrize(('name', 'expected'), [
    ('rigid_body_ros.warm_up', True), ('rigid_body_ros.propagate.warm_up', False),
    ('rigid_body_ros.replay.replay', True), ('so3.rotate', True), ('so3.spin', False),
    ('State.time_ns', True), ('State.time', False)])
def test_a_name_exists_if_it_is_found_as_a_reader_types_it(name, expected):
    assert exists(name, {}) == expected


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings_that_are_there(page):
    assert [target for target in links(page) if not leads_somewhere(page, target)] == []


@pytest.mark.parametrize('page', ['CONTRIBUTING.md', 'docs/design.md', 'docs/theory.md'])
def test_the_source_files_that_a_page_names_are_there(page):
    names = _FILE.findall((ROOT / page).read_text(encoding='utf-8'))
    assert names
    assert [name for name in names
            if not any((folder / name).exists() for folder in (ROOT, PACKAGE))] == []


def test_the_page_of_the_design_lists_the_layers_of_the_contract():
    layers = re.findall(r'^layers = \[\n(.*?)^\]', (ROOT / 'pyproject.toml').read_text(),
                        re.DOTALL | re.MULTILINE)[0].splitlines()
    contract = [sorted(re.findall(r'rigid_body_ros\.(\w+)', layer)) for layer in layers]
    listed, number = [], None
    for row in re.findall(r'^\| (\d*) ?\| ((?:`[\w/.]+`(?:, )?)+) \|', (
            ROOT / 'docs' / 'design.md').read_text(), re.MULTILINE):
        number = row[0] or number
        listed += [(int(number), name) for name in re.findall(r'`(\w+)', row[1])]
    count = len(contract)
    assert listed == [(count - 1 - place, name)
                      for place, names in enumerate(contract) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'arguments'), [('nodes', ()), ('commands', ('commands',))])
def test_a_printed_page_is_what_the_code_declares(name, arguments):
    printed = subprocess.run([sys.executable, ROOT / 'docs' / 'nodes.py', *arguments],
                             capture_output=True, text=True, check=True)
    assert (ROOT / 'docs' / f'{name}.md').read_text(encoding='utf-8') == printed.stdout


@pytest.mark.nightly
def test_sphinx_builds_the_pages_without_a_warning(tmp_path):
    for module in ('myst_parser', 'latex2mathml'):
        pytest.importorskip(module, reason='the extra "docs" is not installed')
    result = subprocess.run([sys.executable, '-m', 'sphinx', '-W', '--keep-going', '-q',
                             ROOT / 'docs', tmp_path], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, '')
    built = {path.stem: path.read_text(encoding='utf-8') for path in tmp_path.glob('*.html')}
    assert {page.stem for page in PAGES[1:]} <= set(built)
    # A reader must see formulas and layout even without a network.
    assert [name for name, text in built.items() if _REMOTE.search(text)] == []
    assert built['theory'].count('<math') > 100
    assert '\\frac' not in built['theory']
    assert '<mi>&</mi>' not in built['theory']  # the mark of an environment that is not understood


def test_the_python_interface_has_every_public_name_and_those_of_examples():
    page = (ROOT / 'docs' / 'api.md').read_text(encoding='utf-8')
    listed = re.findall(r'auto\w+:: (\S+)', page)
    # A subpackage re-exports the names of its modules, but Sphinx finds comments only in modules.
    listed += [re.sub(r'^(\w+[.]\w+)[.]\w+([.]\w+)$', r'\1\2', name) for name in listed]
    public = [f'{NAME}.{name}' for name in rigid_body_ros.__all__]
    assert [name for name in [*public, *names_in_examples()] if not described(name, listed)] == []


def test_the_python_interface_has_an_example_of_every_public_name():
    shown = ' '.join(code for name in ('api', 'library')
                     for code, _ in blocks(ROOT / 'docs' / f'{name}.md'))
    functions = [f'{module}.{name}' for module in ('so3', 'euler') for name, found in vars(
        getattr(rigid_body_ros, module)).items() if getattr(found, '__module__', '').endswith(
            f'mechanics.{module}') and not name.startswith('_')]
    names = [*rigid_body_ros.__all__, *functions]
    # Users do not type the name of a class that a function returns.
    assert [name for name in names if not re.search(rf'\b{re.escape(name)}\b', shown)] == [
        'Trajectories']


def names_in_examples():
    """Return the full names that the examples use from the package; commands are elsewhere."""
    found = set()
    for path in (ROOT / 'examples').glob('*.py'):
        tree = ast.parse(path.read_text(encoding='utf-8'))
        imported = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or '').split('.')[0] == NAME:
                for alias in node.names:
                    imported[alias.asname or alias.name] = f'{node.module}.{alias.name}'
        used = {f'{imported[node.value.id]}.{node.attr}' for node in ast.walk(tree)
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
                and node.value.id in imported}
        found |= used | set(imported.values())
    return sorted(name for name in found if not name.startswith(f'{NAME}.commands'))


def described(name, listed):
    """Return whether the listed names include this name, its module, its class or its members."""
    return any(name == other or name.startswith(f'{other}.') or other.startswith(f'{name}.')
               for other in listed)


def exists(name, names):
    """Return whether a dotted name exists; names that begin with other modules pass."""
    first, *rest = name.split('.')
    found = names.get(first, rigid_body_ros if first == NAME else locate(f'{NAME}.{first}'))
    if found is None:
        return True
    for part in rest:
        if part in getattr(found, '__annotations__', ()):  # a field of a dataclass
            return part == rest[-1]
        if isinstance(found, ModuleType):
            locate(f'{found.__name__}.{part}')  # imports a submodule
        if not hasattr(found, part):
            return False
        found = getattr(found, part)
    return True


def links(page):
    """Return the targets in the repository that a page links to."""
    found = (match[match.lastindex] for match in _LINK.finditer(_prose(page)))
    return [target for target in found if not _EXTERNAL.match(target)]


def leads_somewhere(page, target):
    """Return whether a file exists, and contains the heading named after #."""
    path, _, anchor = target.partition('#')
    file = (page.parent / path).resolve() if path else page
    return file.exists() and (not anchor or anchor in anchors(file))


def anchors(page):
    """Return the anchors that GitHub and MyST give to the headings of a page."""
    names = []
    for title in _HEADING.findall(_FENCE.sub('', page.read_text(encoding='utf-8'))):
        shown = re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', title)
        name = re.sub(r'[^\w\- ]', '', shown.lower()).replace(' ', '-')
        same = sum(re.fullmatch(re.escape(name) + r'(-\d+)?', other) is not None
                   for other in names)
        names.append(f'{name}-{same}' if same else name)
    return names


def _prose(page):
    return _INLINE.sub('', _FENCE.sub('', page.read_text(encoding='utf-8')))
