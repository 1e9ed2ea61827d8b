#!/usr/bin/env python3
"""defaults.py PRINTED [FILE]: compares the defaults that the comments of sbl.h state with the values that the code
sets.

PRINTED is the output of tests/header/defaults.c. The tool prints a line for each offence. The exit status is 1 if there
is one.

The comment of a field states its default in one of these forms. Three numbers are for the presets draft, default and
high. A default in words means that the field stays 0; a field without a statement stays 0, too.

    Default: 16                           Default: 32 / 64 / 128
    Default: 640 x 480                    the first field of the line is 640, the second 480
    Default: SBL_MODE_GI                  an enumerator
    Default: as in sbl_picture_desc       the default of the same field there
    Default of readings: 64               only for these descriptors
    Default in SBL_MODE_PAPER: 0.05       only in these modes
"""
import os, re, sys

os.chdir(os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', '..'))
FRONT_ENDS = {'picture': 'pictures', 'readings': 'readings', 'lightmap': 'lightmaps', 'vertices': 'vertices',
              'probes': 'probes'}
NUMBERED = r'(?:int|float|double|size_t|uint32_t|sbl_mode|sbl_preset|sbl_backend|sbl_sensor_kind)'
STATEMENT = re.compile(r'Default(?: \(all zero\))?(?: of ([a-z ]+))?(?: in ((?:SBL_MODE_\w+(?: and )?)+))?: '
                       r'(?:(as in sbl_picture_desc)|(\d+) x (\d+)|([\d.]*\d(?: / [\d.]*\d)*)|(SBL_\w+))?')


def enumerators(text):
    values = {}
    for body in re.findall(r'^typedef enum \w+ \{(.*?)\} \w+;', text, re.M | re.S):
        names = re.findall(r'(SBL_\w+)(?: = 0)?(?:,|\s|$)', re.sub(r'/\*.*?\*/', '', body, flags=re.S))
        values.update((name, number) for number, name in enumerate(names))
    return values


def fields(text, name):
    """Returns {field: (position in its line, comment)} for the numeric fields of a struct."""
    body = re.search(r'^typedef struct %s \{(.*?)^\} %s;' % (name, name), text, re.M | re.S).group(1)
    found = {}
    for names, comment in re.findall(r'^    %s ([^;(*]+);\s*/\*(.*?)\*/' % NUMBERED, body, re.M | re.S):
        for place, field in enumerate(names.split(',')):
            found[re.sub(r'\[.*', '', field.strip())] = place, re.sub(r'\s+', ' ', comment)
    return found


class Comments:
    def __init__(self, text):
        self.values = enumerators(text)
        self.structs = {name: fields(text, 'sbl_%s_desc' % name) for name in list(FRONT_ENDS) + ['context']}
        options = fields(text, 'sbl_options')
        for name in FRONT_ENDS:
            self.structs[name].update(('options.' + field, row) for field, row in options.items())

    def default(self, name, field, mode):
        """Returns the values for the three presets."""
        place, comment = self.structs[name][field]
        best, value = -1, [0.0] * 3
        for m in STATEMENT.finditer(comment):
            ends, modes, inherited, wide, high, numbers, word = m.groups()
            if ends and FRONT_ENDS.get(name) not in re.split(r' and ', ends):
                continue
            if modes and mode not in [self.values[x] for x in modes.split(' and ')]:
                continue
            rank = 2 * bool(modes) + bool(ends)
            if rank <= best:
                continue
            best = rank
            if inherited:
                value = self.default('picture', field, mode)
            elif wide:
                value = [float((wide, high)[place])] * 3
            elif numbers:
                given = [float(x) for x in numbers.split(' / ')]
                value = given if len(given) == 3 else [given[0]] * 3
            else:
                value = [float(self.values[word]) if word else 0.0] * 3
        return value


def offences(text, printed):
    comments = Comments(text)
    # the caller of sbl_..._desc_defaults sets the others
    unseen = {(name, field) for name, struct in comments.structs.items() for field in struct
              if not field.endswith('canary') and field != 'options.preset'}
    for line in printed:
        name, field, mode, *values = line.split()
        field = re.sub(r'\[.*', '', field)
        if field not in comments.structs[name]:
            yield '%s.%s has no comment' % (name, field)
            continue
        unseen.discard((name, field))
        if field == 'options.mode' and mode != '0':
            continue
        said = comments.default(name, field, int(mode))
        if any(abs(float(a) - b) > 1e-5 * abs(b) for a, b in zip(values, said)):
            yield 'sbl_%s_desc.%s, mode %s: the comment says %s, the code fills in %s' % (
                name, field, mode, ' '.join('%g' % x for x in said), ' '.join(values))
    for name, field in sorted(unseen):
        yield 'sbl_%s_desc.%s: tests/header/defaults.c does not print it' % (name, field)


def main():
    with open(sys.argv[2] if len(sys.argv) > 2 else 'sbl.h') as f:
        text = f.read()
    with open(sys.argv[1]) as f:
        printed = f.read().splitlines()
    found = list(offences(text, printed))
    print('%d defaults' % len(printed))
    for offence in found:
        print(offence)
    sys.exit(1 if found or len(printed) < 100 else 0)


main()
