% MATLAB's webwrite for text that is sent as it is, by curl: Octave's own sends forms only.
function response = webwrite(url, body, options)
    file = [tempname() '.body'];
    id = fopen(file, 'w');
    fwrite(id, body);
    fclose(id);
    [status, text] = system(sprintf(['curl --silent --show-error --fail-with-body --max-time %g ' ...
        '--header "Content-Type: %s" --data-binary "@%s" "%s"'], options.Timeout, options.MediaType, file, url));
    delete(file);
    if status ~= 0, error('webwrite: %s', text); end
    response = jsondecode(text);
end
