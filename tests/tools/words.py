#!/usr/bin/env python3
"""words.py [FILE]: checks the words of sbl.h. It prints a line for each offence, and exits with 1 if there is one.

    rooms       each >>room that sbl.h mentions exists
    chapters    each chapter of the manual that sbl.h mentions ("see ON MEMORY") exists
    names       each name of the interface that the manual mentions, such as sbl_step or SBL_MODE_GI, is declared
    glossary    it has at most 40 terms; each prefix occurs; private functions with a prefix of the glossary are defined
                only in the rooms that its row names
    words       no word of BANNED occurs in sbl.h
    sentences   no sentence of the manual and of the implementation's opening comment begins with a word of BEGINNINGS
"""
import os, re, sys

os.chdir(os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', '..'))
TERMS = 40
# Words that sbl.h must not use, as words or as parts of names, and what to use instead.
BANNED = {
    'prober': 'stuck test',
    'relighting': 'update of the light',
    'seeing': 'options, measurement',
    'doubt': 'uncertainty, standard error',
    'doubts': 'uncertainty, standard error',
    'relit': 'update of the light',
    'relight': 'update of the light',
    'feeler': 'contact ray',
    'feelers': 'contact rays',
    'looking': 'inspection; looks at, sees',
    'skyless': 'without_sky',
    'lens': 'kind of looks, sheets',
    'lenses': 'kinds of looks, sheets',
    'afar': 'long rays',
    'goes_on': 'continues',
}
BEGINNINGS = 'Of', 'That', 'And'


def rooms(text):
    """Returns (offset, name) of the heading of each room."""
    return [(m.start(), m.group(1)) for m in re.finditer(r'^/\* =+ >>(\w+)$', text, re.M)]


def unknown_rooms(text):
    known = {name for _, name in rooms(text)} | {'glsl'}
    for number, line in enumerate(text.split('\n'), 1):
        if re.match(r'/\* >>\w+( types)?\b(?!:)', line) or re.match(r'\s*"?//', line):
            continue  # a section of the interface or of a shader
        for name in re.findall(r'(?<![\w)] )(?<!\w)>>([a-z]+)', line):
            if name not in known:
                yield 'sbl.h:%d: there is no room >>%s' % (number, name)


def unknown_chapters(text):
    manual = text[:text.index('\n*/\n')]
    chapters = re.findall(r'^   ([A-Z][A-Z ]+)$', manual, re.M)
    joined = re.sub(r'\n *', ' ', text)
    for name in sorted(set(re.findall(r'\bON(?: [A-Z]{2,})+', joined))):
        if name not in chapters:
            yield 'sbl.h: the manual has no chapter %s' % name


def unknown_names(text):
    end = text.index('\n*/\n')
    declared = set(re.findall(r'\b(?:sbl|SBL)_\w+', text[end:]))
    for name in sorted(set(re.findall(r'\b(?:sbl|SBL)_\w+(?<!_)\b', text[:end]))):
        if name not in declared:
            yield 'sbl.h: the manual mentions %s, which is not declared' % name


def glossary(text):
    """Returns the rows: (term, prefix or '', [rooms])."""
    part = re.search(r'\n   GLOSSARY\n.*?\n   term +prefix[^\n]*\n(.*?)\n\n', text, re.S)
    if not part:
        sys.exit('words.py: sbl.h has no glossary')
    rows = []
    for line in part.group(1).split('\n'):
        m = (re.match(r'   (\S+(?: \S+)*) +(sbl__\w+)((?: +>>\w+)+) {2,}\S', line) or
             re.match(r'   (\S+(?: \S+)*?) {3,}()()\S', line))
        rows.append((m.group(1), m.group(2), re.findall(r'>>(\w+)', m.group(3))) if m else (line, None, []))
    return rows


def glossary_offences(text):
    rows, heads = glossary(text), rooms(text)
    if len(rows) > TERMS:
        yield 'sbl.h: the glossary has %d terms; at most %d' % (len(rows), TERMS)
    for term, prefix, allowed in rows:
        if prefix is None:
            yield 'sbl.h: the glossary has a row that cannot be read: ' + term
            continue
        if not prefix:
            continue
        places = [m for m in re.finditer(r'^(?:static|SBL_API) [^=;\n(]*?\b(%s(?:_\w+)?)\(' % prefix, text, re.M)]
        if not re.search(r'\b%s' % prefix, text[heads[0][0]:]):
            yield 'sbl.h: the glossary says %s for %s; no such name occurs' % (prefix, term)
        for m in places:
            room = [name for start, name in heads if start < m.start()][-1:]
            if room and room[0] not in allowed:
                yield 'sbl.h:%d: %s is defined in >>%s; the glossary says %s' % (
                    text.count('\n', 0, m.start()) + 1, m.group(1), room[0], ' '.join('>>' + name for name in allowed))


def plain_parts(text):
    """Returns the manual, and the opening comment of the implementation."""
    begin = text.index('#define SBL_IMPLEMENTATION_INCLUDED')
    return text[:text.index('\n*/\n')], text[begin:text.index('*/', begin)]


def banned_words(text):
    for m in re.finditer(r'(?<![a-z])(%s)(?![a-z])' % '|'.join(BANNED), text, re.I):
        line = text.count('\n', 0, m.start()) + 1
        yield 'sbl.h:%d: the word "%s"; use %s' % (line, m.group(1), BANNED[m.group(1).lower()])


def sentences(text):
    for part in plain_parts(text):
        joined = re.sub(r'\s+', ' ', part)
        for m in re.finditer(r'(?:[.:;] |/\* )((?:%s) [^.]{0,40})' % '|'.join(BEGINNINGS), joined):
            yield 'sbl.h: a sentence begins with "%s"' % m.group(1)


def main():
    with open(sys.argv[1] if len(sys.argv) > 1 else 'sbl.h') as f:
        text = f.read()
    checks = unknown_rooms, unknown_chapters, unknown_names, glossary_offences, banned_words, sentences
    offences = [offence for find in checks for offence in find(text)]
    print('%d terms in the glossary, %d banned words' % (len(glossary(text)), len(BANNED)))
    for offence in offences:
        print(offence)
    sys.exit(1 if offences else 0)


main()
