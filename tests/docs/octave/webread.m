% MATLAB's webread of JSON, by curl.
function response = webread(url, options)
    [status, text] = system(sprintf( ...
        'curl --silent --show-error --fail-with-body --max-time %g "%s"', options.Timeout, url));
    if status ~= 0, error('webread: %s', text); end
    response = jsondecode(text);
end
