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

"""The documentation: what it shows runs and gives what it says, and its links lead somewhere."""

import doctest
import re
import subprocess
import sys

from conftest import ROOT
import pytest

PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
_FENCE = re.compile(r'^(```+|~~~+)(\w*)[^\n]*\n(.*?)^\1[`~]*[ ]*$', re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r'(`+)(?:(?!\n\n).)*?\1', re.DOTALL)
_LINK = re.compile(r'\]\(\s*([^)\s]+)[^)]*\)|^\[[^\]]+\]:\s*(\S+)|\b(?:src|href)="([^"]+)"',
                   re.MULTILINE)
_HEADING = re.compile(r'^#{1,6} +(.*?) *#*$', re.MULTILINE)
_EXTERNAL = re.compile(r'[a-z][a-z+.-]*:')


def blocks(page):
    """Return the fenced blocks of Python, and how many lines come before each."""
    text = page.read_text(encoding='utf-8')
    return [(match[3], text.count('\n', 0, match.start(3))) for match in _FENCE.finditer(text)
            if match[2] in ('python', 'pycon')]


@pytest.mark.parametrize('page', [page for page in PAGES if blocks(page)], ids=lambda p: p.name)
def test_the_code_of_a_page_runs_and_prints_what_it_says(page):
    # In order and with one set of names, as a reader would type it; a warning is an error. Long
    # messages may be wrapped.
    names, said = {'__name__': '__main__'}, []
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    for code, before in blocks(page):
        if '>>>' in code:
            examples = doctest.DocTestParser().get_doctest(code, names, page.name, page, before)
            runner.run(examples, out=said.append, clear_globs=False)
            names = examples.globs
        else:
            exec(compile('\n' * before + code, page, 'exec'), names)
    assert not said, ''.join(said)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_no_example_stands_where_it_is_not_run(page):
    shown = re.findall(r'^\s*>>> ', page.read_text(encoding='utf-8'), re.MULTILINE)
    run = [line for code, _ in blocks(page) for line in code.splitlines()
           if line.lstrip().startswith('>>> ')]
    assert len(shown) == len(run)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings_that_are_there(page):
    assert [target for target in links(page) if not leads_somewhere(page, target)] == []


def test_the_page_of_nodes_is_what_the_code_declares():
    page = ROOT / 'docs' / 'nodes.md'
    printed = subprocess.run([sys.executable, page.with_suffix('.py')], capture_output=True,
                             text=True, check=True)
    assert page.read_text(encoding='utf-8') == printed.stdout


@pytest.mark.slow
def test_sphinx_builds_the_pages_without_a_warning(tmp_path):
    pytest.importorskip('myst_parser', reason='the extra "docs" is not installed')
    result = subprocess.run([sys.executable, '-m', 'sphinx', '-W', '--keep-going', '-q',
                             ROOT / 'docs', tmp_path], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, '')
    assert {page.stem for page in PAGES[1:]} <= {page.stem for page in tmp_path.glob('*.html')}


def links(page):
    """Return what a page links to inside of the repository."""
    found = (match[match.lastindex] for match in _LINK.finditer(_prose(page)))
    return [target for target in found if not _EXTERNAL.match(target)]


def leads_somewhere(page, target):
    """Tell whether a file is there, and has the heading that is named behind #."""
    path, _, anchor = target.partition('#')
    file = (page.parent / path).resolve() if path else page
    return file.exists() and (not anchor or anchor in anchors(file))


def anchors(page):
    """Return the names that GitHub, and MyST after it, give to the headings of a page."""
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
