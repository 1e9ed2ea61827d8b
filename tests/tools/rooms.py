#!/usr/bin/env python3
"""rooms.py [FILE]: prints the rooms of sbl.h with their lines and GL calls, its longest functions, and violations of
these rules:

    a line of more than 120 columns, in sbl.h, README.md, shaders_embedded, examples/*.[ch], scripts and tests;
    a function of more than 80 lines or 6 parameters in the implementation;
    a GL call outside of the rooms gl and device

Prints the table, then a line for each offence; exits with 1 if there is one. Run by test_header.sh.
"""
import glob, os, re, sys

os.chdir(os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', '..'))
COLUMNS, LINES, PARAMETERS = 120, 80, 6
GL_ROOMS = {'gl', 'device'}
LONGEST = 20
NARROW = ['README.md', 'shaders_embedded/*.glsl', 'examples/*.[ch]', 'scripts/*', 'tests/**/*']
BINARY = ('.pyc', '.png', '.pfm', '.exr')


def functions(lines):
    """Returns (name, first line, lines, parameters) of each function defined at the left margin."""
    start = None
    for number, line in enumerate(lines, 1):
        if start is None and re.match(r'(static |SBL_API )[^=;]*\($|(static |SBL_API )[^=;]*\([^=;]*$',
                                      line) and not line.startswith('static const'):
            start = number
        if start is None:
            continue
        if line.rstrip().endswith(';') and '{' not in ''.join(lines[start - 1:number]):
            start = None
            continue
        if line.startswith('}') or (number == start and re.search(r'\}\s*$', line)):
            text = ''.join(lines[start - 1:number])
            head = text[:text.index('{')]
            name = re.search(r'(\w+)\s*\(', head).group(1)
            depth, commas, inside = 0, 0, head[head.index('(') + 1:]
            for c in inside:
                depth += (c == '(') - (c == ')')
                commas += c == ',' and depth == 0
            yield name, start, number - start + 1, 0 if inside.strip().startswith('void)') else commas + 1
            start = None


def main():
    path = sys.argv[1] if len(sys.argv) > 1 else 'sbl.h'
    with open(path) as f:
        lines = f.readlines()
    implementation = next(i for i, line in enumerate(lines, 1) if line.startswith('#ifdef SBL_IMPLEMENTATION'))
    offences, rooms, room = [], {}, 'manual and interface'
    for number, line in enumerate(lines, 1):
        tag = re.match(r'/\* =+ >>(\w+)|/\* >>(shaders):', line)
        if number == implementation:
            room = 'opening'
        if tag:
            room = tag.group(1) or tag.group(2)
        count = rooms.setdefault(room, [0, 0, 0])
        count[0] += 1
        # a function pointer that is passed on counts as a call
        calls = len(re.findall(r'\bgl(?:->|\.)\(?[A-Z]\w*', line))
        count[1] += calls
        if calls and room not in GL_ROOMS and number > implementation:
            offences.append('%s:%d: a GL call in room %s' % (path, number, room))
        if len(line.rstrip('\n')) > COLUMNS:
            count[2] += 1
            offences.append('%s:%d: %d columns' % (path, number, len(line.rstrip('\n'))))
    if len(sys.argv) < 2:
        for other in sorted(sum((glob.glob(pattern, recursive=True) for pattern in NARROW), [])):
            if os.path.isfile(other) and not other.endswith(BINARY) and '/corpus/' not in other:
                with open(other) as f:
                    offences += ['%s:%d: %d columns' % (other, number, len(line.rstrip('\n')))
                                 for number, line in enumerate(f, 1) if len(line.rstrip('\n')) > COLUMNS]
    found = [f for f in functions(lines) if f[1] > implementation]
    for name, start, count, parameters in found:
        if count > LINES:
            offences.append('%s:%d: %s has %d lines' % (path, start, name, count))
        if parameters > PARAMETERS and not name.startswith('sbl_look_at') and not name.startswith('sbl_inspect_sensor'):
            offences.append('%s:%d: %s has %d parameters' % (path, start, name, parameters))
    print('%-24s %6s %9s %s' % ('room', 'lines', 'GL calls', 'lines over %d columns' % COLUMNS))
    for name, (count, calls, wide) in rooms.items():
        print('%-24s %6d %9d %6d' % (name, count, calls, wide))
    print('%-24s %6d %9d %6d' % ('all', *[sum(r[k] for r in rooms.values()) for k in range(3)]))
    print('\nthe longest of %d functions:' % len(found))
    for name, start, count, parameters in sorted(found, key=lambda f: -f[2])[:LONGEST]:
        print('%4d lines, %2d parameters  %s' % (count, parameters, name))
    print('\nparameters: ' + ', '.join('%d functions have %d' % (sum(f[3] == n for f in found), n) for n
                                       in range(6, 13) if any(f[3] == n for f in found)))
    if offences:
        print()
    for offence in offences:
        print(offence)
    sys.exit(1 if offences else 0)


main()
