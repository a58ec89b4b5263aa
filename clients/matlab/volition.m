function lab = volition(url)
% VOLITION  Talk to a Volition server: ten functions for MATLAB and Octave, in this one file.
%
%   lab = volition('http://127.0.0.1:8080')          the server; it is asked at once
%   study = lab.study('tracking', struct('display_limit', 8))    found by its name, or made
%   plant = lab.plant(study, 'integrator', [1], [1 0])           num, den, and a sample time where it has one
%   subject = lab.subject(study, 's01', struct('group', 'practice'))
%   trial = lab.upload(subject, plant, [t r u y], struct('number', 1, 'session', 1))    or the path of a file
%   analysis = lab.run('ssid', trial, spec)          of a trial, of several as a cell, of a study, or of inputs
%   analysis = lab.wait(analysis)                    until it is finished; an error where it failed
%   report = lab.report(analysis)                    its result, warnings and quantities
%   rows = lab.curves(study)                         learning curves, a struct a trial: struct2table(rows)
%   system = lab.model(report, 'feedback')           tf or ss where there is a control toolbox, else a struct
%
% Specs and inputs are structs, or JSON text: jsonencode writes a list of one as a number, so that lists of one are
% cells, {1}. What the server refuses is an error with the reason, the place and how to mend it. Requests go through
% curl, which Windows 10, macOS and Linux have.
    if nargin < 1, url = 'http://127.0.0.1:8080'; end
    url = regexprep(url, '/+$', '');
    index = get_json(url, '/v1');
    lab = struct( ...
        'url', url, ...
        'version', index.version, ...
        'study', @(name, varargin) study(url, name, varargin{:}), ...
        'plant', @(study, name, varargin) plant(url, study, name, varargin{:}), ...
        'subject', @(study, code, varargin) subject(url, study, code, varargin{:}), ...
        'upload', @(subject, plant, source, varargin) upload(url, subject, plant, source, varargin{:}), ...
        'run', @(kind, of, varargin) run(url, kind, of, varargin{:}), ...
        'wait', @(work, varargin) wait(url, work, varargin{:}), ...
        'report', @(analysis) report(url, analysis), ...
        'curves', @(study, varargin) curves(url, study, varargin{:}), ...
        'model', @(source, varargin) model(source, varargin{:}));
end

function found = study(url, name, more)
    if nargin < 3, more = struct(); end
    found = named(url, '/v1/studies', 'name', name);
    if isempty(found)
        more.name = name;
        found = post_json(url, '/v1/studies', jsonencode(more));
    end
end

function found = plant(url, study, name, num, den, sample_time_s)
    folder = ['/v1/studies/' study.id '/plants'];
    found = named(url, folder, 'name', name);
    if ~isempty(found), return, end
    if nargin < 5, error('volition:plant', 'there is no plant ''%s'' yet: give num and den', name); end
    period = 'null';
    if nargin > 5 && ~isempty(sample_time_s) && sample_time_s > 0, period = sprintf('%.17g', sample_time_s); end
    body = sprintf('{"name": %s, "model": {"num": %s, "den": %s, "sample_time_s": %s}}', ...
        jsonencode(name), numbers(num), numbers(den), period);
    found = post_json(url, folder, body);
end

function found = subject(url, study, code, more)
    if nargin < 4, more = struct(); end
    folder = ['/v1/studies/' study.id '/subjects'];
    found = named(url, folder, 'code', code);
    if isempty(found)
        more.code = code;
        found = post_json(url, folder, jsonencode(more));
    end
end

function trial = upload(url, subject, plant, source, options)
    if nargin < 5, options = struct(); end
    query = ['?plant=' plant.id];
    names = fieldnames(options);
    for k = 1:numel(names)
        value = options.(names{k});
        if ~ischar(value), value = sprintf('%.17g', value); end
        query = [query '&' names{k} '=' encoded(value)]; %#ok<AGROW>
    end
    media = 'text/csv';
    made = '';
    if ischar(source)
        file = source;
        if ~isempty(regexpi(file, '\.(mat|npz|xlsx|zip)$', 'once')), media = 'application/octet-stream'; end
    else
        file = [tempname() '.csv'];
        made = file;
        heads = {'r,u,y', 't,r,u,y', 't,r,u,y,d'};
        if size(source, 2) < 3 || size(source, 2) > 5
            error('volition:upload', 'give columns [r u y], [t r u y] or [t r u y d], not %d', size(source, 2));
        end
        id = fopen(file, 'w');
        fprintf(id, '%s\n', heads{size(source, 2) - 2});
        % Seventeen digits return the same doubles.
        fprintf(id, [strjoin(repmat({'%.17g'}, 1, size(source, 2)), ',') '\n'], source');
        fclose(id);
    end
    try
        trial = request(url, 'POST', ['/v1/subjects/' subject.id '/trials' query], file, media, '');
    catch problem
        remove(made);
        rethrow(problem);
    end
    remove(made);
end

function work = run(url, kind, of, spec, more)
    if nargin < 4 || isempty(spec), spec = struct(); end
    if nargin < 5, more = '{}'; end
    spec = as_json(spec);
    if isstruct(of) && isfield(of, 'display_limit')
        % A study: one analysis for each trial that has none yet.
        extra = strtrim(as_json(more));
        extra = strtrim(extra(2:end - 1));
        if ~isempty(extra), extra = [', ' extra]; end
        body = ['{"kind": "' kind '", "spec": ' spec extra '}'];
        work = post_json(url, ['/v1/studies/' of.id '/analyses'], body);
        return
    end
    if iscell(of)
        ids = cellfun(@(trial) ['"' trial.id '"'], of, 'UniformOutput', false);
        inputs = ['{"trials": [' strjoin(ids, ', ') ']}'];
    elseif isstruct(of) && isfield(of, 'sample_time_s') && isfield(of, 'id')
        inputs = ['{"trial": "' of.id '"}'];
    else
        inputs = as_json(of);
    end
    work = post_json(url, '/v1/analyses', ['{"kind": "' kind '", "inputs": ' inputs ', "spec": ' spec '}']);
end

function done = wait(url, work, timeout_s)
    if nargin < 3, timeout_s = Inf; end
    started = tic();
    if isfield(work, 'analyses')
        ids = [each(work.analyses), each(work.existing)];
        done = cellfun(@(one) finished(url, one.id, started, timeout_s), ids, 'UniformOutput', false);
        return
    end
    done = finished(url, work.id, started, timeout_s);
    if ~strcmp(done.status, 'succeeded')
        why = '';
        if isfield(done, 'problem') && isstruct(done.problem), why = [': ' done.problem.title ': ' done.problem.detail]; end
        error(['volition:' done.status], 'the analysis %s was %s%s', done.id, done.status, why);
    end
end

function found = finished(url, id, started, timeout_s)
    while true
        left = max(0, min(20, ceil(timeout_s - toc(started))));
        found = get_json(url, ['/v1/analyses/' id], sprintf('Prefer: wait=%d', left));
        if any(strcmp(found.status, {'succeeded', 'failed', 'cancelled'})), return, end
        if toc(started) >= timeout_s
            error('volition:timeout', 'analysis %s is %s, %.0f %% done', id, found.status, 100 * found.progress.fraction);
        end
    end
end

function found = report(url, analysis)
    id = analysis;
    if isstruct(analysis), id = analysis.id; end
    found = get_json(url, ['/v1/analyses/' id '/report']);
    trust = get_json(url, ['/v1/analyses/' id '/trust']);
    found.warnings = each(found.warnings);
    found.quantities = each(trust.trust);
end

function rows = curves(url, study, query)
    if nargin < 3, query = ''; else, query = ['?' query]; end
    found = get_json(url, ['/v1/studies/' study.id '/learning-curves' query]);
    rows = struct([]);
    groups = each(found.groups);
    for g = 1:numel(groups)
        subjects = each(groups{g}.subjects);
        for s = 1:numel(subjects)
            points = each(subjects{s}.curve.points);
            for p = 1:numel(points)
                row = points{p};
                row.group = groups{g}.group;
                row.subject = subjects{s}.code;
                row.plant = groups{g}.plant.name;
                trust = each(row.trust);
                for k = 1:numel(trust)
                    row.([trust{k}.quantity '_trust']) = trust{k}.level;
                end
                row = rmfield(row, 'trust');
                if isempty(rows), rows = row; else, rows(end + 1) = orderfields(row, rows); end %#ok<AGROW>
            end
        end
    end
end

function system = model(source, name)
    if nargin < 2, name = 'feedback'; end
    if isfield(source, 'result')
        found = source.result;
        members = strsplit(name, '.');
        for k = 1:numel(members)
            if ~isstruct(found) || ~isfield(found, members{k})
                error('volition:model', 'the report has no model %s', name);
            end
            found = found.(members{k});
        end
    elseif isfield(source, 'model')
        found = source.model;
    else
        found = source;
    end
    period = 0;
    if isfield(found, 'sample_time_s') && ~isempty(found.sample_time_s), period = found.sample_time_s; end
    if isfield(found, 'num')
        % A row each, also where JSON gives columns.
        found.num = found.num(:).';
        found.den = found.den(:).';
    end
    system = found;
    if isfield(found, 'num') && has('tf')
        if period == 0, system = tf(found.num, found.den); else, system = tf(found.num, found.den, period); end
    elseif isfield(found, 'a') && has('ss')
        if period == 0
            system = ss(found.a, found.b, found.c, found.d);
        else
            system = ss(found.a, found.b, found.c, found.d, period);
        end
    else
        system.sample_time_s = period;
        return
    end
    if isfield(found, 'delay_s') && ~isempty(found.delay_s) && found.delay_s > 0
        if period == 0, system.InputDelay = found.delay_s; else, system.InputDelay = round(found.delay_s / period); end
    end
end

% ---- what all of them use

function yes = has(name)
    yes = any(exist(name) == [2 3 5 6]) || any(exist(name, 'class') == 8); %#ok<EXIST>
end

function remove(file)
    if ~isempty(file), delete(file); end
end

function text = as_json(value)
    if ischar(value), text = value; return, end
    if isstruct(value) && isempty(fieldnames(value)), text = '{}'; return, end
    text = jsonencode(value);
end

function text = numbers(values)
    parts = arrayfun(@(value) sprintf('%.17g', value), values(:).', 'UniformOutput', false);
    text = ['[' strjoin(parts, ', ') ']'];
end

function text = encoded(value)
    text = '';
    for byte = unicode2native(value, 'UTF-8')
        if any(byte == uint8(['a':'z' 'A':'Z' '0':'9' '-._~']))
            text = [text char(byte)]; %#ok<AGROW>
        else
            text = [text sprintf('%%%02X', byte)]; %#ok<AGROW>
        end
    end
end

% A list as a row of cells: jsondecode makes struct arrays, cells or nothing of one.
function items = each(list)
    if iscell(list), items = list(:).'; elseif isempty(list), items = {}; else, items = num2cell(list(:).'); end
end

% The thing of a list that has this name; [] where there is none.
function found = named(url, folder, field, name)
    found = [];
    lines = strsplit(strtrim(request_text(url, 'GET', folder, '', '', 'Accept: application/x-ndjson')), char(10));
    for k = 1:numel(lines)
        if isempty(lines{k}), continue, end
        own = jsondecode(lines{k});
        if strcmp(own.(field), name), found = own; return, end
    end
end

function answer = get_json(url, path, header)
    if nargin < 3, header = ''; end
    answer = request(url, 'GET', path, '', '', header);
end

function answer = post_json(url, path, body)
    file = [tempname() '.json'];
    id = fopen(file, 'w');
    fwrite(id, unicode2native(body, 'UTF-8'));
    fclose(id);
    try
        answer = request(url, 'POST', path, file, 'application/json', '');
    catch problem
        remove(file);
        rethrow(problem);
    end
    remove(file);
end

function answer = request(url, method, path, file, media, header)
    answer = jsondecode(request_text(url, method, path, file, media, header));
end

% Sends a request and gives the body of the answer; an error with the problem where the server refuses.
function text = request_text(url, method, path, file, media, header)
    call = sprintf('curl --silent --show-error --compressed --max-time 600 --request %s', method);
    if ~isempty(file)
        % One key for all attempts: what an answer that was lost has made is not made again.
        key = sprintf('%s-%s', datestr(now(), 'yyyymmddHHMMSSFFF'), sprintf('%d', floor(1e6 * rand(1, 4)))); %#ok<TNOW1,DATST>
        call = sprintf('%s --retry 3 --header "Content-Type: %s" --header "Idempotency-Key: %s" --data-binary "@%s"', ...
            call, media, key, file);
    end
    if ~isempty(header), call = sprintf('%s --header "%s"', call, header); end
    [failed, text] = system(sprintf('%s --write-out "\\n%%{http_code}" "%s%s" 2>&1', call, url, path));
    if failed
        error('volition:unreachable', 'the server at %s does not answer: %s', url, strtrim(regexprep(text, '\s*000\s*$', '')));
    end
    ends = find(text == char(10), 1, 'last');
    status = str2double(text(ends + 1:end));
    text = text(1:ends - 1);
    if status >= 400
        problem = jsondecode(text);
        said = [problem.title ': ' problem.detail];
        if isfield(problem, 'where'), said = [said ' | at ' problem.where]; end
        if isfield(problem, 'mend'), said = [said ' | ' problem.mend]; end
        error(['volition:' problem.code], '%s', said);
    end
end
