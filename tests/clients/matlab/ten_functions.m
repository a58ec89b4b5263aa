% The ten functions of clients/matlab against a real server. Usage: VOLITION_URL=.. octave-cli ten_functions.m, with
% clients/matlab on the path.
lab = volition([getenv('VOLITION_URL') '/']);
assert(~isempty(lab.version));
study = lab.study('Tracking & more', struct('display_limit', 8));
again = lab.study('Tracking & more');
assert(strcmp(again.id, study.id));
plant = lab.plant(study, '1/s', 1, [1 0]);
again = lab.plant(study, '1/s');
assert(strcmp(again.id, plant.id));
subject = lab.subject(study, 's01', struct('group', 'practice'));
again = lab.subject(study, 's01');
assert(strcmp(again.group, 'practice'));

step = 0.02; t = (0:step:60)'; n = numel(t);
lines = [2 3 5 7 11 13 17 19 23 29];
r = sum(sin(2 * pi * t * lines / 60 + repmat(lines .^ 2, n, 1)), 2) / 5;
trials = {};
for number = 1:2
    u = zeros(n, 1); y = zeros(n, 1); lag = 0;
    for i = 1:n
        e = 0;
        if i > 10, e = r(i - 10) - y(i - 10); end
        lag = lag + step / 0.2 * ((0.6 + 0.4 * number) * e - lag);
        u(i) = lag;
        if i < n, y(i + 1) = y(i) + step * u(i); end
    end
    trials{number} = lab.upload(subject, plant, [t r u y], struct('number', number, 'session', 1)); %#ok<SAGROW>
end
assert(trials{2}.number == 2 && trials{1}.metrics.mean_abs_error ~= trials{2}.metrics.mean_abs_error);

axis_of_pool = '[{"from": 0.5, "to": 10, "step": 0.5}]';
spec = ['{"pool": {"grid": {"feedforward_denominator": ' axis_of_pool ', "feedback_numerator": ' axis_of_pool ...
    ', "feedback_denominator": ' axis_of_pool '}}, "feedforward_numerator_degree": 1, "frequency": {"lines": ' ...
    '{"frequency_hz": ' jsonencode(lines / 60) '}, "segments": [{"start_s": 0, "end_s": 60}]}}'];
done = lab.wait(lab.run('ssid', trials{2}, spec), 120);
assert(strcmp(done.status, 'succeeded') && done.trial.number == 2);
report = lab.report(done);
assert(strcmp(report.kind, 'ssid') && iscell(report.quantities) && ~isempty(report.quantities{1}.level));

work = lab.run('ssid', study, spec);
assert(work.created == 1);
every = lab.wait(work, 120);
assert(numel(every) == 2 && all(cellfun(@(one) strcmp(one.status, 'succeeded'), every)));

rows = lab.curves(study);
assert(isequal([rows.number], [1 2]) && strcmp(rows(2).analysis, done.id) && strcmp(rows(1).subject, 's01'));
assert(ischar(rows(1).norm_feedback_trust));

system_found = lab.model(report, 'feedback');
if isstruct(system_found)
    assert(isequal(system_found.den, report.result.feedback.den(:).'));
end
of_plant = lab.model(plant);
assert(~isstruct(of_plant) || (isequal(of_plant.num, 1) && of_plant.sample_time_s == 0));

try
    lab.run('ssid', trials{1}, '{"pool": "no such pool"}');
    error('test:not_refused', 'it should be refused');
catch problem
    assert(strcmp(problem.identifier, 'volition:invalid') && ~isempty(strfind(problem.message, 'at /spec'))); %#ok<STREMP>
end
try
    volition('http://127.0.0.1:1');
    error('test:not_refused', 'nobody listens there');
catch problem
    assert(strcmp(problem.identifier, 'volition:unreachable'), problem.message);
end
disp('matlab: ten functions, a study, two trials, two reports');
